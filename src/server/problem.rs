//! What the service refuses, as RFC 9457 problem details.

use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::openapi::RefOr;
use utoipa::openapi::schema::{ObjectBuilder, Schema, Type};
use utoipa::{PartialSchema, ToSchema};

use crate::error::{Error, Field, Limit, Place};
use crate::server::config;

/// The stable word of a problem. Each has a page under `/problems/`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) enum Code {
    MalformedRequest,
    UriTooLong,
    HeadersTooLarge,
    HostNotAllowed,
    CrossOrigin,
    Unauthorized,
    ReadOnlyToken,
    UnknownRoute,
    MethodNotAllowed,
    NotAcceptable,
    UnsupportedMediaType,
    BodyTooLarge,
    BodyTimeout,
    UnknownWorld,
    UnknownParticle,
    MalformedJson,
    MalformedCbor,
    MalformedSnapshot,
    RevisionMismatch,
    WorldExists,
    IdempotencyKeyInFlight,
    IdempotencyKeyReused,
    InvalidIdempotencyKey,
    InvalidWorldName,
    InvalidField,
    UnknownField,
    DuplicateField,
    MissingField,
    InvalidParameter,
    NotFinite,
    MassNotPositive,
    InverseMassNegative,
    MassAndInverseMass,
    DampingOutOfRange,
    LengthMismatch,
    RemovedTwice,
    DurationNotPositive,
    MaxStepNotPositive,
    StepsNotPositive,
    StepsAndMaxStep,
    ClockOutOfRange,
    IntegratorOwnsField,
    IntegratorCannotServeDamping,
    IntegratorCannotServeForces,
    IntegratorTakesNoSteps,
    NegativeValue,
    UnsupportedSnapshotVersion,
    PrecisionMismatch,
    ComputeBudget,
    AnswerTooLarge,
    LimitReached,
    Diverged,
    InternalError,
    WorldQuarantined,
    Overloaded,
    ShuttingDown,
}

impl Code {
    pub(crate) const ALL: [Self; 56] = [
        Self::MalformedRequest,
        Self::UriTooLong,
        Self::HeadersTooLarge,
        Self::HostNotAllowed,
        Self::CrossOrigin,
        Self::Unauthorized,
        Self::ReadOnlyToken,
        Self::UnknownRoute,
        Self::MethodNotAllowed,
        Self::NotAcceptable,
        Self::UnsupportedMediaType,
        Self::BodyTooLarge,
        Self::BodyTimeout,
        Self::UnknownWorld,
        Self::UnknownParticle,
        Self::MalformedJson,
        Self::MalformedCbor,
        Self::MalformedSnapshot,
        Self::RevisionMismatch,
        Self::WorldExists,
        Self::IdempotencyKeyInFlight,
        Self::IdempotencyKeyReused,
        Self::InvalidIdempotencyKey,
        Self::InvalidWorldName,
        Self::InvalidField,
        Self::UnknownField,
        Self::DuplicateField,
        Self::MissingField,
        Self::InvalidParameter,
        Self::NotFinite,
        Self::MassNotPositive,
        Self::InverseMassNegative,
        Self::MassAndInverseMass,
        Self::DampingOutOfRange,
        Self::LengthMismatch,
        Self::RemovedTwice,
        Self::DurationNotPositive,
        Self::MaxStepNotPositive,
        Self::StepsNotPositive,
        Self::StepsAndMaxStep,
        Self::ClockOutOfRange,
        Self::IntegratorOwnsField,
        Self::IntegratorCannotServeDamping,
        Self::IntegratorCannotServeForces,
        Self::IntegratorTakesNoSteps,
        Self::NegativeValue,
        Self::UnsupportedSnapshotVersion,
        Self::PrecisionMismatch,
        Self::ComputeBudget,
        Self::AnswerTooLarge,
        Self::LimitReached,
        Self::Diverged,
        Self::InternalError,
        Self::WorldQuarantined,
        Self::Overloaded,
        Self::ShuttingDown,
    ];

    pub(crate) fn name(self) -> &'static str {
        self.row().0
    }

    pub(crate) fn status(self) -> StatusCode {
        self.row().1
    }

    pub(crate) fn title(self) -> &'static str {
        self.row().2
    }

    pub(crate) fn explanation(self) -> &'static str {
        self.row().3
    }

    /// A refusal with it, for the description.
    pub(crate) fn example(self) -> serde_json::Value {
        let pointer = EXAMPLE_POINTERS.iter().find(|(code, _)| *code == self).map(|(_, pointer)| *pointer);
        let diverged = Divergence { particle: 0, quantity: "position", step: 1 };
        let problem = Problem {
            pointer: pointer.map(str::to_owned),
            diverged: (self == Self::Diverged).then_some(diverged),
            ..Problem::plain(self)
        };
        serde_json::to_value(problem.wire()).expect("strings and whole numbers are always JSON")
    }

    /// Name, status, title, explanation.
    #[rustfmt::skip]
    fn row(self) -> (&'static str, StatusCode, &'static str, &'static str) {
        use StatusCode as S;
        const MEANING: StatusCode = StatusCode::UNPROCESSABLE_ENTITY;
        match self {
            Self::MalformedRequest => ("malformed_request", S::BAD_REQUEST, "Not HTTP",
                "The request line or a header is not HTTP/1.1."),
            Self::UriTooLong => ("uri_too_long", S::URI_TOO_LONG, "Path too long",
                "The path with its parameters is longer than --uri-bytes-max."),
            Self::HeadersTooLarge => ("headers_too_large", S::REQUEST_HEADER_FIELDS_TOO_LARGE, "Headers too large",
                "A request has at most 100 headers, and of them at most --header-bytes-max."),
            Self::HostNotAllowed => ("host_not_allowed", S::FORBIDDEN, "Host not allowed",
                "The Host header must be a loopback name, an IP address, or a name given with --allow-host. This keeps web pages from reaching the service through a name of their own."),
            Self::CrossOrigin => ("cross_origin", S::FORBIDDEN, "Request from another origin",
                "A browser sent this request from another site. Allow that site with --allow-origin."),
            Self::Unauthorized => ("unauthorized", S::UNAUTHORIZED, "No valid token",
                "Send one of the tokens of the service as `Authorization: Bearer TOKEN`."),
            Self::ReadOnlyToken => ("read_only_token", S::FORBIDDEN, "The token is read-only",
                "This token is good for GET and HEAD. A change, a dry run too, needs one that is not read-only."),
            Self::UnknownRoute => ("unknown_route", S::NOT_FOUND, "Unknown route",
                "There is nothing at this path. GET /openapi.json lists every route."),
            Self::MethodNotAllowed => ("method_not_allowed", S::METHOD_NOT_ALLOWED, "Method not allowed",
                "The path exists, with other methods: the sentence and the Allow header name them."),
            Self::NotAcceptable => ("not_acceptable", S::NOT_ACCEPTABLE, "Not acceptable",
                "The answer would be application/json or application/cbor (a snapshot application/octet-stream, a stream text/event-stream or \
                 application/jsonl), and the Accept header excludes it."),
            Self::UnsupportedMediaType => ("unsupported_media_type", S::UNSUPPORTED_MEDIA_TYPE, "Unsupported media type",
                "A body is read as CBOR when its Content-Type is application/cbor, and as JSON when it is absent, JSON, text/* or application/x-www-form-urlencoded; \
                 a snapshot when it is absent, application/octet-stream or application/x-www-form-urlencoded. \
                 Compressed bodies are not read."),
            Self::BodyTooLarge => ("body_too_large", S::PAYLOAD_TOO_LARGE, "Body too large",
                "Send it in parts, or raise --body-bytes-max; for a snapshot, --snapshot-bytes-max."),
            Self::BodyTimeout => ("body_timeout", S::REQUEST_TIMEOUT, "Body too slow",
                "The body did not arrive in the time of --body-timeout-ms."),
            Self::UnknownWorld => ("unknown_world", S::NOT_FOUND, "Unknown world",
                "Create it with PUT /v1/worlds/{world}."),
            Self::UnknownParticle => ("unknown_particle", S::NOT_FOUND, "Unknown particle",
                "It was never created, or it was removed: ids are never used again."),
            Self::MalformedJson => ("malformed_json", S::BAD_REQUEST, "Not JSON",
                "The body is not JSON, or it is cut short."),
            Self::MalformedCbor => ("malformed_cbor", S::BAD_REQUEST, "Not CBOR",
                "The body is not CBOR (RFC 8949), or it is cut short."),
            Self::MalformedSnapshot => ("malformed_snapshot", S::BAD_REQUEST, "Not a snapshot",
                "The body is no snapshot of a world, or it is cut short, damaged, or of a world that cannot be."),
            Self::RevisionMismatch => ("revision_mismatch", S::PRECONDITION_FAILED, "The world has changed",
                "If-Match names a revision that is not the present one. Read the world again and decide anew."),
            Self::WorldExists => ("world_exists", S::CONFLICT, "The world exists",
                "Choose another name, change the settings of the world with PATCH, or DELETE it first."),
            Self::IdempotencyKeyInFlight => ("idempotency_key_in_flight", S::CONFLICT, "Still in flight",
                "The first request with this Idempotency-Key has not ended. Ask again when it has."),
            Self::IdempotencyKeyReused => ("idempotency_key_reused", MEANING, "Idempotency-Key of another request",
                "This key came with another method, path, If-Match or body before. Each intent has a key of its own; what is sent again is the same to the byte."),
            Self::InvalidIdempotencyKey => ("invalid_idempotency_key", MEANING, "Invalid Idempotency-Key",
                "A request has one Idempotency-Key, of 1 to 255 bytes."),
            Self::InvalidWorldName => ("invalid_world_name", MEANING, "Invalid world name",
                "A name is a letter or digit and then up to 63 letters, digits, _ or -."),
            Self::InvalidField => ("invalid_field", MEANING, "Invalid value",
                "The value at `pointer` has the wrong type, shape or range."),
            Self::UnknownField => ("unknown_field", MEANING, "Unknown field",
                "The field at `pointer` is not part of this request; unknown fields are refused, not ignored."),
            Self::DuplicateField => ("duplicate_field", MEANING, "Duplicate field",
                "An object names the same field twice."),
            Self::MissingField => ("missing_field", MEANING, "Missing field",
                "A field that this request needs is absent."),
            Self::InvalidParameter => ("invalid_parameter", MEANING, "Invalid query parameter",
                "A parameter after the ? is unknown here, repeated, or has a value it does not take."),
            Self::NotFinite => ("not_finite", MEANING, "Not finite",
                "A number, or what the command would make of it, is beyond the largest one of the precision of the world."),
            Self::MassNotPositive => ("mass_not_positive", MEANING, "Mass not positive",
                "A mass is above 0 kg. For a particle that nothing moves, set inverse_mass to 0."),
            Self::InverseMassNegative => ("inverse_mass_negative", MEANING, "Inverse mass negative",
                "An inverse mass is at least 0; 0 is an immovable particle."),
            Self::MassAndInverseMass => ("mass_and_inverse_mass", MEANING, "Mass and inverse mass",
                "Both say the same thing: give one of them."),
            Self::DampingOutOfRange => ("damping_out_of_range", MEANING, "Damping out of range",
                "Damping is the share of the velocity that is kept each second: between 0 and 1."),
            Self::LengthMismatch => ("length_mismatch", MEANING, "Wrong number of values",
                "A list has one value for each particle; a single value stands for all of them."),
            Self::RemovedTwice => ("removed_twice", MEANING, "Removed twice",
                "A list of particles to remove names one of them twice."),
            Self::DurationNotPositive => ("duration_not_positive", MEANING, "Duration not positive",
                "An advance goes forward in time by more than 0 seconds."),
            Self::MaxStepNotPositive => ("max_step_not_positive", MEANING, "Longest step not positive",
                "max_step is above 0 seconds; leave it out for a single step."),
            Self::StepsNotPositive => ("steps_not_positive", MEANING, "No steps",
                "An advance takes at least 1 step."),
            Self::StepsAndMaxStep => ("steps_and_max_step", MEANING, "Steps and longest step",
                "Both choose the number of steps: give one of them."),
            Self::ClockOutOfRange => ("clock_out_of_range", MEANING, "Clock out of range",
                "The clock of a world stays below 2^400 seconds."),
            Self::IntegratorOwnsField => ("integrator_owns_field", MEANING, "The integrator owns this field",
                "Position and velocity follow from the motion. POST …/impulse changes the velocity, POST …/place teleports."),
            Self::IntegratorCannotServeDamping => ("integrator_cannot_serve_damping", MEANING, "Integrator and damping law do not go together",
                "The damping law per_step belongs to newton_euler, newton_euler_quadratic and semi_implicit_euler."),
            Self::IntegratorCannotServeForces => ("integrator_cannot_serve_forces", MEANING, "Integrator and forces do not go together",
                "exact has no closed form for drag and gravitation. Take velocity_verlet, rk4, dop853 or an Euler integrator."),
            Self::IntegratorTakesNoSteps => ("integrator_takes_no_steps", MEANING, "The integrator takes no steps",
                "dop853 chooses its steps by the tolerance of the world. Leave steps out; max_step is the longest it may take."),
            Self::NegativeValue => ("negative_value", MEANING, "Negative value",
                "Coefficients of drag, the constant and the softening of gravitation, gravitational masses and tolerances are at least 0."),
            Self::UnsupportedSnapshotVersion => ("unsupported_snapshot_version", MEANING, "Unknown version of snapshots",
                "The snapshot was written by another version of the service, in a form that this one does not know."),
            Self::PrecisionMismatch => ("precision_mismatch", MEANING, "World of another precision",
                "A world keeps its precision. Restore the snapshot under another name, or delete the world first."),
            Self::ComputeBudget => ("compute_budget", MEANING, "Over the compute budget",
                "One request has so many simulated seconds, steps, and steps x particles or interactions. Advance in several, or raise the limit that the sentence names."),
            Self::AnswerTooLarge => ("answer_too_large", MEANING, "Answer too large",
                "Ask for fewer properties or particles, or raise --answer-bytes-max. The answer to a change with an Idempotency-Key is kept, and has at most 1 MiB."),
            Self::LimitReached => ("limit_reached", MEANING, "Limit reached",
                "The service holds as many worlds, or the world as many particles, as it may. GET /v1 shows the limits."),
            Self::Diverged => ("diverged", MEANING, "The advance would diverge",
                "A number would become infinite, so nothing was changed. `particle`, `quantity` and `step` say where it happens first."),
            Self::InternalError => ("internal_error", S::INTERNAL_SERVER_ERROR, "Internal error",
                "A defect of the service. Its log has more under the x-request-id of the response."),
            Self::WorldQuarantined => ("world_quarantined", S::INTERNAL_SERVER_ERROR, "World quarantined",
                "A defect interrupted a change of this world, so its state is not to be trusted. Delete it; other worlds are not affected."),
            Self::Overloaded => ("overloaded", S::SERVICE_UNAVAILABLE, "Over capacity",
                "Too many requests wait for the same thing, or this one waited too long. Nothing was changed; try again after the seconds of Retry-After."),
            Self::ShuttingDown => ("shutting_down", S::SERVICE_UNAVAILABLE, "Shutting down",
                "The service finishes what it has begun and takes on nothing new."),
        }
    }
}

/// Where an example of a refusal points to.
const EXAMPLE_POINTERS: [(Code, &str); 12] = [
    (Code::InvalidField, "/position"),
    (Code::NotFinite, "/position/0"),
    (Code::LengthMismatch, "/position"),
    (Code::IntegratorOwnsField, "/position"),
    (Code::MassNotPositive, "/mass"),
    (Code::InverseMassNegative, "/inverse_mass"),
    (Code::MassAndInverseMass, "/inverse_mass"),
    (Code::DampingOutOfRange, "/damping"),
    (Code::DurationNotPositive, "/duration"),
    (Code::StepsNotPositive, "/steps"),
    (Code::MaxStepNotPositive, "/max_step"),
    (Code::StepsAndMaxStep, "/max_step"),
];

/// The stable words of problems.
#[derive(Debug)]
pub(crate) struct ProblemCode;

impl PartialSchema for ProblemCode {
    fn schema() -> RefOr<Schema> {
        let names = Code::ALL.map(Code::name);
        RefOr::T(Schema::Object(ObjectBuilder::new().schema_type(Type::String).enum_values(Some(names)).build()))
    }
}

impl ToSchema for ProblemCode {}

/// No code is left out of the list.
const _: () = assert!(Code::ShuttingDown as usize + 1 == Code::ALL.len());

/// A refusal: what a client gets instead of what it asked for.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Problem {
    pub(crate) code: Code,
    /// One sentence that a person can act on.
    pub(crate) detail: String,
    /// JSON Pointer into the body of the request.
    pub(crate) pointer: Option<String>,
    diverged: Option<Divergence>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Divergence {
    particle: u64,
    quantity: &'static str,
    step: u64,
}

/// Problem details (RFC 9457). `code` is stable; `detail` is for people.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Problem, example = json!({
    "type": "/problems/mass_not_positive", "title": "Mass not positive", "status": 422,
    "detail": "mass must be above 0; an immovable particle has inverse_mass 0",
    "code": "mass_not_positive", "pointer": "/mass"
}))]
pub(crate) struct ProblemBody<'a> {
    /// A relative URL with an explanation.
    r#type: String,
    title: &'a str,
    status: u16,
    /// One sentence that a person can act on.
    detail: &'a str,
    /// The stable word.
    #[schema(value_type = ProblemCode)]
    code: &'a str,
    /// JSON Pointer (RFC 6901) into the request body.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pointer: Option<&'a str>,
    /// With `diverged`: the smallest id of a particle that would not stay finite.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    particle: Option<u64>,
    /// With `diverged`: `position` or `velocity`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    quantity: Option<&'a str>,
    /// With `diverged`: the first step, from 1, after which it is not finite.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    step: Option<u64>,
}

impl Problem {
    pub(crate) fn new(code: Code, detail: impl Into<String>) -> Self {
        Self { code, detail: detail.into(), pointer: None, diverged: None }
    }

    pub(crate) fn at(code: Code, pointer: impl Into<String>, detail: impl Into<String>) -> Self {
        Self { pointer: Some(pointer.into()), ..Self::new(code, detail) }
    }

    /// Whether the body is nothing that could be read: told before what else is wrong.
    pub(crate) fn is_malformed(&self) -> bool {
        self.code.status() == StatusCode::BAD_REQUEST
    }

    /// The same of a part of the request, to which this pointer leads.
    pub(crate) fn under(mut self, prefix: &str) -> Self {
        // Line and column would be those of the part.
        if let Some(end) = self.detail.rfind(" at line ") {
            self.detail.truncate(end);
        }
        Self { pointer: Some(format!("{prefix}{}", self.pointer.unwrap_or_default())), ..self }
    }

    /// The same with this pointer into the body.
    pub(crate) fn pointing_to(self, pointer: &str) -> Self {
        Self { pointer: Some(pointer.to_owned()), ..self }
    }

    /// The same with more to say.
    pub(crate) fn adding(self, more: &str) -> Self {
        Self { detail: self.detail + more, ..self }
    }

    /// The same of query parameters, into which no pointer leads.
    pub(crate) fn without_pointer(self) -> Self {
        Self { pointer: None, ..self }
    }

    /// The problem that its explanation already says in full.
    pub(crate) fn plain(code: Code) -> Self {
        Self::new(code, code.explanation())
    }

    /// What the engine refused, with pointers into a request of this shape.
    pub(crate) fn from_engine(error: Error, shape: Shape) -> Self {
        let detail = error.to_string();
        let at = |code, place: Place| Self::at(code, shape.pointer(place), detail.clone());
        let whole = |code, field: &str| Self::at(code, format!("/{field}"), detail.clone());
        match error {
            Error::NotFinite(place) | Error::MassTooSmall(place) | Error::Overflow { place, .. } => {
                at(Code::NotFinite, place)
            }
            Error::MassNotPositive(place) => at(Code::MassNotPositive, place),
            Error::InverseMassNegative(place) => at(Code::InverseMassNegative, place),
            Error::DampingOutOfRange(place) => at(Code::DampingOutOfRange, place),
            Error::LengthMismatch { field, .. } => whole(Code::LengthMismatch, field.name()),
            Error::DurationNotPositive => whole(Code::DurationNotPositive, "duration"),
            Error::MaxStepNotPositive => whole(Code::MaxStepNotPositive, "max_step"),
            Error::StepsNotPositive => whole(Code::StepsNotPositive, "steps"),
            Error::StepsAndMaxStep => whole(Code::StepsAndMaxStep, "max_step"),
            Error::NothingToPlace => Self::new(Code::MissingField, detail),
            Error::ClockOutOfRange => whole(Code::ClockOutOfRange, "duration"),
            Error::IntegratorCannotServeDamping { .. } => Self::new(Code::IntegratorCannotServeDamping, detail),
            Error::IntegratorCannotServeZeroDamping { place: Some(place), .. } => {
                at(Code::IntegratorCannotServeDamping, place)
            }
            Error::IntegratorCannotServeZeroDamping { place: None, .. } => {
                Self::new(Code::IntegratorCannotServeDamping, detail)
            }
            Error::IntegratorCannotServeForces { .. } => Self::new(Code::IntegratorCannotServeForces, detail),
            Error::IntegratorTakesNoSteps { .. } => whole(Code::IntegratorTakesNoSteps, "steps"),
            Error::TooManySteps { .. } => Self::new(Code::ComputeBudget, detail),
            Error::Negative(place) => at(Code::NegativeValue, place),
            Error::ToleranceZero => whole(Code::InvalidField, "tolerance"),
            Error::PlaneWithoutNormal => at(Code::InvalidField, Field::Normal.whole()),
            Error::TooFewSamples => Self::new(Code::InvalidParameter, detail),
            Error::UnknownParticle { index, .. } => match shape {
                Shape::Particle => Self::new(Code::UnknownParticle, detail),
                Shape::World => whole(Code::UnknownParticle, "until/particle"),
                Shape::Columns | Shape::List => Self::at(Code::UnknownParticle, format!("/ids/{index}"), detail),
            },
            Error::RemovedTwice { index, .. } => whole(Code::RemovedTwice, &format!("ids/{index}")),
            Error::Diverged { particle, quantity, step } => Self {
                diverged: Some(Divergence { particle: particle.0, quantity: quantity.name(), step }),
                ..Self::new(Code::Diverged, detail)
            },
            Error::LimitReached { limit, .. } => {
                let (code, flag) = match limit {
                    Limit::Particles => (Code::LimitReached, config::PARTICLES_MAX),
                    Limit::Steps => (Code::ComputeBudget, config::STEPS_MAX),
                    Limit::ParticleSteps => (Code::ComputeBudget, config::PARTICLE_STEPS_MAX),
                    Limit::Interactions => (Code::ComputeBudget, config::INTERACTIONS_MAX),
                };
                let detail = format!("{detail} (--{flag})");
                match (limit, shape) {
                    (Limit::Particles, Shape::Columns) => Self::at(code, "/count", detail),
                    _ => Self::new(code, detail),
                }
            }
            Error::Cancelled => Self::plain(Code::ShuttingDown),
        }
    }
}

/// How a request names the values of particles, for pointers into it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Shape {
    /// One particle, named in the path: `/mass`.
    Particle,
    /// Columns: `/mass` or `/mass/3`.
    Columns,
    /// A list of particles: `/3/mass`.
    List,
    /// The world: its settings, or an advance of it.
    World,
}

impl Shape {
    fn pointer(self, place: Place) -> String {
        let field = self.field(place.field);
        match (self, place.index) {
            // What all of them share is wrong in the first one.
            (Self::List, index) => format!("/{}/{field}", index.unwrap_or_default()),
            (Self::Columns, Some(index)) => format!("/{field}/{index}"),
            (Self::Particle | Self::World, _) | (_, None) => format!("/{field}"),
        }
    }

    /// The way to a field.
    fn field(self, field: Field) -> &'static str {
        match (field, self) {
            (Field::K1, Self::World) => "forces/drag/k1",
            (Field::K2, Self::World) => "forces/drag/k2",
            // The drag of a particle is a list of both.
            (Field::K1 | Field::K2, _) => Field::Drag.name(),
            (Field::Constant, _) => "forces/gravitation/constant",
            (Field::Softening, _) => "forces/gravitation/softening",
            (Field::Absolute, _) => "tolerance/absolute",
            (Field::Relative, _) => "tolerance/relative",
            (Field::Normal, _) => "until/plane/normal",
            (Field::Offset, _) => "until/plane/offset",
            (field, _) => field.name(),
        }
    }
}

impl Problem {
    /// The body of its answer.
    pub(crate) fn body(&self) -> Vec<u8> {
        let mut body = serde_json::to_vec(&self.wire()).expect("strings and whole numbers are always JSON");
        body.push(b'\n');
        body
    }

    /// As it is told.
    pub(crate) fn wire(&self) -> ProblemBody<'_> {
        ProblemBody {
            r#type: format!("/problems/{}", self.code.name()),
            title: self.code.title(),
            status: self.code.status().as_u16(),
            detail: &self.detail,
            code: self.code.name(),
            pointer: self.pointer.as_deref(),
            particle: self.diverged.map(|d| d.particle),
            quantity: self.diverged.map(|d| d.quantity),
            step: self.diverged.map(|d| d.step),
        }
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let content_type = [(header::CONTENT_TYPE, "application/problem+json")];
        let mut response = (self.code.status(), content_type, self.body()).into_response();
        if self.code == Code::Unauthorized {
            response.headers_mut().insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
        }
        if self.code.status() == StatusCode::SERVICE_UNAVAILABLE {
            response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from_static("1"));
        }
        response
    }
}

#[cfg(test)]
mod tests {
    use super::Code;

    #[test]
    fn names_are_distinct() {
        let names: std::collections::HashSet<&str> = Code::ALL.iter().map(|code| code.name()).collect();
        assert_eq!(names.len(), Code::ALL.len());
    }
}
