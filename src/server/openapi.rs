//! The `OpenAPI` description: paths and bodies come from the routes, what all of them share is added here.

use utoipa::openapi::header::Header;
use utoipa::openapi::path::{Operation, Parameter, ParameterBuilder, ParameterIn};
use utoipa::openapi::schema::{Object, Schema, Type};
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityRequirement, SecurityScheme};
use utoipa::openapi::{
    ContentBuilder, InfoBuilder, LicenseBuilder, OpenApi, PathItem, Ref, RefOr, Required, ResponseBuilder, Tag,
};
use utoipa::{PartialSchema, ToSchema};

use crate::server::problem::{Code, ProblemBody};

/// The whole description as JSON.
pub(crate) fn document(mut api: OpenApi) -> Vec<u8> {
    api.info = InfoBuilder::new()
        .title("pointmass")
        .version(env!("CARGO_PKG_VERSION"))
        .description(Some(INTRODUCTION))
        .license(Some(LicenseBuilder::new().name("MIT OR Apache-2.0").identifier(Some("MIT OR Apache-2.0")).build()))
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
    let text = api.to_pretty_json().expect("a description is plain data").replace("_f64", "");
    (text + "\n").into_bytes()
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
    let parameters = operation.parameters.get_or_insert_default();
    if path.contains("{world}") {
        parameters.push(parameter("world", ParameterIn::Path, "the name of the world", Type::String));
    }
    if path.contains("{id}") {
        parameters.push(parameter("id", ParameterIn::Path, "the id of the particle", Type::Integer));
    }
    let of_a_world = path.contains("{world}");
    if of_a_world && method == "get" {
        parameters.push(parameter(
            "if-none-match",
            ParameterIn::Header,
            "answer 304 when this is still the revision",
            Type::String,
        ));
        let etag = Header::new(Schema::Object(Object::with_type(Type::String)));
        let unchanged = ResponseBuilder::new().description("Not modified").header("etag", etag).build();
        operation.responses.responses.insert("304".to_owned(), RefOr::T(unchanged));
    }
    if of_a_world && method != "get" {
        parameters.push(parameter(
            "if-match",
            ParameterIn::Header,
            "refuse with 412 when this is no longer the revision",
            Type::String,
        ));
    }
    if path.starts_with("/v1/") && method != "get" {
        parameters.push(parameter(
            "idempotency-key",
            ParameterIn::Header,
            "1 to 255 bytes; the same request sent again with the same key is done once, and answered with \
             `idempotency-replayed: true`. A world keeps the answers of its last changes with a key: `keys_max` of them, \
             for `key_lifetime_ms` (GET /v1)",
            Type::String,
        ));
    }
    if let Some(RefOr::T(body)) = &mut operation.request_body {
        let may_be_empty =
            matches!(operation.operation_id.as_deref(), Some("create_world" | "create_named_by_service"));
        // The same shapes.
        let json = body.content.get("application/json").cloned();
        body.content.extend(json.map(|json| ("application/cbor".to_owned(), json)));
        body.required = Some(if may_be_empty { Required::False } else { Required::True });
    }
    for response in operation.responses.responses.values_mut() {
        let RefOr::T(response) = response else { continue };
        if response.description.is_empty() {
            "Done".clone_into(&mut response.description);
        }
        if path.starts_with("/v1") {
            let json = response.content.get("application/json").cloned();
            response.content.extend(json.map(|json| ("application/cbor".to_owned(), json)));
        }
    }
    let mut by_status: std::collections::BTreeMap<u16, Vec<Code>> = std::collections::BTreeMap::new();
    for code in codes(path, method, operation.operation_id.as_deref().unwrap_or_default()) {
        by_status.entry(code.status().as_u16()).or_default().push(code);
    }
    for (status, codes) in by_status {
        let listed: Vec<String> = codes.iter().map(|code| format!("`{}`", code.name())).collect();
        let content = ContentBuilder::new().schema(Some(RefOr::Ref(Ref::from_schema_name("Problem")))).build();
        let response =
            ResponseBuilder::new().description(listed.join(", ")).content("application/problem+json", content);
        operation.responses.responses.insert(status.to_string(), RefOr::T(response.build()));
    }
}

fn parameter(name: &str, place: ParameterIn, description: &str, schema: Type) -> RefOr<Parameter> {
    let required = if matches!(place, ParameterIn::Path) { Required::True } else { Required::False };
    let schema = Schema::Object(Object::with_type(schema));
    let parameter = ParameterBuilder::new()
        .name(name)
        .parameter_in(place)
        .description(Some(description))
        .required(required)
        .schema(Some(schema));
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
    let open = matches!(path, "/healthz" | "/readyz" | "/problems/{code}");
    if !open {
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
