//! The `OpenAPI` description: paths and bodies come from the routes, what all of them share is added here.

use std::collections::BTreeMap;

use serde_json::{Value, json};
use utoipa::openapi::example::{Example, ExampleBuilder};
use utoipa::openapi::header::Header;
use utoipa::openapi::path::{Operation, Parameter, ParameterBuilder, ParameterIn};
use utoipa::openapi::schema::{
    AdditionalProperties, KnownFormat, Object, ObjectBuilder, Schema, SchemaFormat, SchemaType, Type,
};
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityRequirement, SecurityScheme};
use utoipa::openapi::{
    ContentBuilder, InfoBuilder, LicenseBuilder, OpenApi, PathItem, Ref, RefOr, Required, ResponseBuilder, Tag,
};
use utoipa::{PartialSchema, ToSchema};

use crate::server::access::OPEN;
use crate::server::problem::{Code, ProblemBody};

/// Stands for `application/cbor` until the text is made: maps of content are sorted by name, and clients take the first.
const CBOR_AFTER_JSON: &str = "application/x-cbor";

/// The whole description as JSON.
pub(crate) fn document(mut api: OpenApi) -> Vec<u8> {
    api.info = InfoBuilder::new()
        .title("pointmass")
        .version(env!("CARGO_PKG_VERSION"))
        .description(Some(INTRODUCTION))
        // Its identifier would be shown as a link to a page of that name, which of two licenses there is not.
        .license(Some(LicenseBuilder::new().name("MIT OR Apache-2.0").build()))
        .build();
    api.tags = Some(
        [
            ("worlds", "Worlds and their settings"),
            ("particles", "Particles, their properties and their state"),
            ("forces", "Forces and impulses"),
            ("advance", "Time"),
            ("commands", "Several commands in one request"),
            ("service", "The service itself"),
        ]
        .map(|(name, description)| {
            let mut tag = Tag::new(name);
            tag.description = Some(description.to_owned());
            tag
        })
        .to_vec(),
    );
    let components = api.components.get_or_insert_default();
    components.schemas.insert("Problem".to_owned(), ProblemBody::schema());
    let mut nested = Vec::new();
    ProblemBody::schemas(&mut nested);
    components.schemas.extend(nested);
    components.schemas.values_mut().for_each(close);
    for code in Code::ALL {
        let example = ExampleBuilder::new().summary(code.title()).value(Some(code.example())).build();
        components.examples.insert(code.name().to_owned(), RefOr::T(example));
    }
    components.security_schemes.insert(
        "token".to_owned(),
        RefOr::T(SecurityScheme::Http(
            HttpBuilder::new().scheme(HttpAuthScheme::Bearer).description(Some("Where the service has tokens")).build(),
        )),
    );
    api.security = Some(vec![SecurityRequirement::default(), SecurityRequirement::new("token", Vec::<String>::new())]);
    for (path, item) in &mut api.paths.paths {
        for (method, operation) in operations(item) {
            complete(path, method, operation);
        }
    }
    // Shapes are generic over the precision; the description shows them once, without the name of the type.
    let text = api.to_pretty_json().expect("a description is plain data");
    // The registry of formats has no hyphen there.
    let text = text.replace("_f64", "").replace("\"u-int", "\"uint").replace(CBOR_AFTER_JSON, "application/cbor");
    (text + "\n").into_bytes()
}

/// Bytes that are no JSON.
pub(crate) fn binary(description: &str) -> Schema {
    let bytes =
        ObjectBuilder::new().schema_type(Type::String).format(Some(SchemaFormat::KnownFormat(KnownFormat::Binary)));
    bytes.description(Some(description)).build().into()
}

/// An object has the members that are described and no others, so that a value is of one shape alone.
fn close(schema: &mut RefOr<Schema>) {
    if let RefOr::T(Schema::Object(object)) = schema
        && !object.properties.is_empty()
    {
        object.additional_properties.get_or_insert_with(|| Box::new(AdditionalProperties::FreeForm(false)));
        object.properties.values_mut().for_each(size);
    }
}

/// Counts have no format of their own.
fn size(schema: &mut RefOr<Schema>) {
    if let RefOr::T(Schema::Object(object)) = schema
        && object.schema_type == SchemaType::Type(Type::Integer)
    {
        object.format.get_or_insert(SchemaFormat::KnownFormat(KnownFormat::UInt64));
    }
}

const INTRODUCTION: &str = "Worlds of point-mass particles: create, set, advance by a duration, read. \
Numbers keep their bits on the way in and out. A refused request changes nothing; a refusal is problem details \
(RFC 9457) with a stable `code`. Units are SI by convention.";

fn operations(item: &mut PathItem) -> impl Iterator<Item = (&'static str, &mut Operation)> {
    [
        ("get", &mut item.get),
        ("put", &mut item.put),
        ("post", &mut item.post),
        ("patch", &mut item.patch),
        ("delete", &mut item.delete),
    ]
    .into_iter()
    .filter_map(|(method, operation)| operation.as_mut().map(|operation| (method, operation)))
}

/// Adds what follows from path and method: names in the path, conditional headers, and every problem.
fn complete(path: &str, method: &str, operation: &mut Operation) {
    if OPEN.contains(&path) {
        operation.security = Some(Vec::new());
    }
    let parameters = operation.parameters.get_or_insert_default();
    for parameter in &mut *parameters {
        if let RefOr::T(Parameter { schema: Some(schema), .. }) = parameter {
            size(schema);
        }
    }
    if path.contains("{world}") {
        let text = Object::with_type(Type::String);
        parameters.push(in_path("world", "the name of the world", text, json!("demo")));
    }
    if path.contains("{id}") {
        let id = ObjectBuilder::new().schema_type(Type::Integer).minimum(Some(0_u32));
        let id = id.format(Some(SchemaFormat::KnownFormat(KnownFormat::UInt64))).build();
        parameters.push(in_path("id", "the id of the particle", id, json!(0)));
    }
    let of_a_world = path.contains("{world}");
    if of_a_world && method == "get" {
        parameters.push(in_header("if-none-match", "answer 304 when this is still the revision"));
        let etag = Header::new(Schema::Object(Object::with_type(Type::String)));
        let unchanged = ResponseBuilder::new().description("Not modified").header("etag", etag).build();
        operation.responses.responses.insert("304".to_owned(), RefOr::T(unchanged));
    }
    if of_a_world && method != "get" {
        parameters.push(in_header("if-match", "refuse with 412 when this is no longer the revision"));
    }
    if path.starts_with("/v1/") && method != "get" {
        parameters.push(in_header(
            "idempotency-key",
            "1 to 255 bytes; the same request sent again with the same key is done once, and answered with \
             `idempotency-replayed: true`. A world keeps the answers of its last changes with a key: `keys_max` of them, \
             for `key_lifetime_ms` (GET /v1)",
        ));
    }
    if let Some(RefOr::T(body)) = &mut operation.request_body {
        let may_be_empty =
            matches!(operation.operation_id.as_deref(), Some("create_world" | "create_named_by_service"));
        // The same shapes.
        let json = body.content.get("application/json").cloned();
        body.content.extend(json.map(|json| (CBOR_AFTER_JSON.to_owned(), json)));
        body.required = Some(if may_be_empty { Required::False } else { Required::True });
    }
    for response in operation.responses.responses.values_mut() {
        let RefOr::T(response) = response else { continue };
        if response.description.is_empty() {
            "Done".clone_into(&mut response.description);
        }
        if path.starts_with("/v1") {
            let json = response.content.get("application/json").cloned();
            response.content.extend(json.map(|json| (CBOR_AFTER_JSON.to_owned(), json)));
        }
    }
    let mut by_status: BTreeMap<u16, Vec<Code>> = BTreeMap::new();
    for code in codes(path, method, operation.operation_id.as_deref().unwrap_or_default()) {
        by_status.entry(code.status().as_u16()).or_default().push(code);
    }
    for (status, codes) in by_status {
        let listed: Vec<String> = codes.iter().map(|code| format!("`{}`", code.name())).collect();
        let example = |code: &Code| {
            (code.name(), RefOr::<Example>::Ref(Ref::new(format!("#/components/examples/{}", code.name()))))
        };
        let content = ContentBuilder::new()
            .schema(Some(Ref::from_schema_name("Problem")))
            .examples_from_iter(codes.iter().map(example))
            .build();
        let response =
            ResponseBuilder::new().description(listed.join(", ")).content("application/problem+json", content);
        operation.responses.responses.insert(status.to_string(), RefOr::T(response.build()));
    }
}

fn in_path(name: &str, description: &str, schema: Object, example: Value) -> RefOr<Parameter> {
    let parameter = ParameterBuilder::new()
        .name(name)
        .parameter_in(ParameterIn::Path)
        .required(Required::True)
        .description(Some(description))
        .schema(Some(Schema::Object(schema)))
        .example(Some(example));
    RefOr::T(parameter.build())
}

fn in_header(name: &str, description: &str) -> RefOr<Parameter> {
    let parameter = ParameterBuilder::new()
        .name(name)
        .parameter_in(ParameterIn::Header)
        .required(Required::False)
        .description(Some(description))
        .schema(Some(Schema::Object(Object::with_type(Type::String))));
    RefOr::T(parameter.build())
}

/// Every problem that a route can answer with. A test holds each refusal it sees against this.
pub(crate) fn codes(path: &str, method: &str, operation: &str) -> Vec<Code> {
    let mut codes = vec![
        Code::MalformedRequest,
        Code::UriTooLong,
        Code::HeadersTooLarge,
        Code::HostNotAllowed,
        Code::CrossOrigin,
        Code::InternalError,
    ];
    if !OPEN.contains(&path) {
        codes.push(Code::Unauthorized);
        codes.extend((method != "get").then_some(Code::ReadOnlyToken));
    }
    codes.extend((path != "/healthz").then_some(Code::ShuttingDown));
    codes.extend((path == "/readyz" || path.starts_with("/v1/")).then_some(Code::Overloaded));
    codes.push(Code::InvalidParameter);
    if matches!(path, "/problems/{code}" | "/docs/{asset}") {
        codes.push(Code::UnknownRoute);
    }
    if !path.starts_with("/v1") {
        return codes;
    }
    codes.push(Code::NotAcceptable);
    if path.contains("{world}") && operation != "create_world" {
        codes.extend([Code::UnknownWorld, Code::WorldQuarantined]);
    }
    if path.contains("{id}") {
        codes.push(Code::UnknownParticle);
    }
    if method != "get" {
        codes.extend([
            Code::UnsupportedMediaType,
            Code::BodyTooLarge,
            Code::BodyTimeout,
            Code::RevisionMismatch,
            Code::MalformedJson,
            Code::MalformedCbor,
            Code::InvalidIdempotencyKey,
            Code::IdempotencyKeyReused,
            Code::IdempotencyKeyInFlight,
            Code::LimitReached,
        ]);
    }
    if matches!(method, "post" | "put" | "patch") {
        codes.extend([Code::InvalidField, Code::UnknownField, Code::DuplicateField, Code::NotFinite]);
    }
    if operation == "restore_world" {
        codes.retain(|code| {
            let of_json =
                [Code::MalformedJson, Code::InvalidField, Code::UnknownField, Code::DuplicateField, Code::NotFinite];
            !of_json.contains(code)
        });
    }
    codes.extend(of_operation(operation));
    codes
}

/// Those of one route, besides what follows from path and method.
fn of_operation(operation: &str) -> Vec<Code> {
    if operation == "run_commands" {
        let commands = ["create_particles", "set_particles", "add_forces", "advance"].map(of_operation).concat();
        let seen = &mut std::collections::HashSet::new();
        return commands.into_iter().chain([Code::RemovedTwice]).filter(|code| seen.insert(*code)).collect();
    }
    let mut codes = Vec::new();
    let masses = [Code::MassNotPositive, Code::InverseMassNegative, Code::MassAndInverseMass];
    let serving = [Code::IntegratorCannotServeDamping, Code::IntegratorCannotServeForces];
    // Among them a coefficient or a mass below 0, and a damping of 0 that the integrator cannot compute with.
    let properties = [Code::DampingOutOfRange, Code::NegativeValue, Code::IntegratorCannotServeDamping];
    match operation {
        "create_world" | "create_named_by_service" => {
            codes.extend(serving);
            codes.extend([Code::WorldExists, Code::MaxStepNotPositive, Code::NegativeValue]);
            codes.extend((operation == "create_world").then_some(Code::InvalidWorldName));
        }
        "configure_world" => {
            codes.extend(serving);
            codes.extend([Code::MaxStepNotPositive, Code::NegativeValue]);
        }
        "restore_world" => codes.extend([
            Code::MalformedSnapshot,
            Code::UnsupportedSnapshotVersion,
            Code::PrecisionMismatch,
            Code::InvalidWorldName,
            Code::WorldExists,
        ]),
        "create_particles" => {
            codes.extend(masses);
            codes.extend(properties);
            codes.push(Code::LengthMismatch);
        }
        "follow_world" => codes.push(Code::UnknownParticle),
        "list_particles" | "read_state" => codes.extend([Code::UnknownParticle, Code::AnswerTooLarge]),
        "set_particles" => {
            codes.extend(masses);
            codes.extend(properties);
            codes.extend([Code::LengthMismatch, Code::IntegratorOwnsField, Code::UnknownParticle]);
        }
        "set_particle" => {
            codes.extend(masses);
            codes.extend(properties);
            codes.push(Code::IntegratorOwnsField);
        }
        "set_mass" => {
            codes.extend(masses);
            codes.push(Code::MissingField);
        }
        "place_particle" | "add_force" | "apply_impulse" | "run_commands_in_worlds" => codes.push(Code::MissingField),
        "add_forces" => codes.extend([Code::MissingField, Code::LengthMismatch, Code::UnknownParticle]),
        "read_trajectory" => codes.extend([
            Code::NotFinite,
            Code::DurationNotPositive,
            Code::ClockOutOfRange,
            Code::ComputeBudget,
            Code::LimitReached,
            Code::AnswerTooLarge,
            Code::Diverged,
        ]),
        "advance" => codes.extend([
            Code::MissingField,
            Code::UnknownParticle,
            Code::IntegratorTakesNoSteps,
            Code::DurationNotPositive,
            Code::StepsNotPositive,
            Code::MaxStepNotPositive,
            Code::StepsAndMaxStep,
            Code::ClockOutOfRange,
            Code::ComputeBudget,
            Code::AnswerTooLarge,
            Code::Diverged,
        ]),
        _ => {}
    }
    codes
}
