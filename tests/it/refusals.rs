//! Every refusal as a row: what is sent, and the status, code and pointer that come back. A refused request changes
//! nothing, and each code of the service is seen at least once.

use std::collections::{BTreeSet, HashSet};

use serde_json::Value;

use crate::openapi::operations;
use crate::service::{Client, Service};

type Row = (&'static str, &'static str, &'static str, u16, &'static str, Option<&'static str>);
type HeaderRow = (&'static str, &'static [(&'static str, &'static str)], u16, &'static str);

/// Method, path, body, status, code, pointer. `@` stands for a world in double, `%` for one in single, both with the
/// particles 0 to 3 of which 3 is removed, under `newton_euler`; `~` for one under `dop853` with two that attract each
/// other.
#[rustfmt::skip]
const ROWS: &[Row] = &[
    // Routes and methods.
    ("GET", "/nothing", "", 404, "unknown_route", None),
    ("GET", "/v2/worlds", "", 404, "unknown_route", None),
    ("GET", "@/nothing", "", 404, "unknown_route", None),
    ("GET", "/v1/worlds/", "", 404, "unknown_route", None),
    ("DELETE", "/v1/worlds", "", 405, "method_not_allowed", None),
    ("PUT", "@/advance", "{}", 405, "method_not_allowed", None),
    ("PATCH", "@/particles/0/mass", "{}", 405, "method_not_allowed", None),
    ("GET", "/problems/no_such_code", "", 404, "unknown_route", None),
    // Names.
    ("GET", "/v1/worlds/nowhere", "", 404, "unknown_world", None),
    ("POST", "/v1/worlds/nowhere/advance", "{\"duration\":1}", 404, "unknown_world", None),
    ("POST", "/v1/worlds/nowhere/advance", "{", 404, "unknown_world", None),
    ("DELETE", "/v1/worlds/nowhere", "", 404, "unknown_world", None),
    ("GET", "@/particles/99", "", 404, "unknown_particle", None),
    ("GET", "@/particles/3", "", 404, "unknown_particle", None),
    ("GET", "@/particles/-1", "", 404, "unknown_particle", None),
    ("GET", "@/particles/01", "", 404, "unknown_particle", None),
    ("GET", "@/particles/x", "", 404, "unknown_particle", None),
    ("PUT", "@/particles/99/mass", "{", 404, "unknown_particle", None),
    ("PUT", "@/particles/3/mass", "{\"mass\":0}", 404, "unknown_particle", None),
    ("GET", "@/particles?ids=0,99", "", 404, "unknown_particle", None),
    ("POST", "@/forces", "{\"ids\":[0,3],\"force\":[1,0,0]}", 404, "unknown_particle", Some("/ids/1")),
    ("PATCH", "@/particles", "{\"ids\":[99],\"damping\":1}", 404, "unknown_particle", Some("/ids/0")),
    ("PUT", "/v1/worlds/-a", "", 422, "invalid_world_name", None),
    ("PUT", "/v1/worlds/a.b", "{}", 422, "invalid_world_name", None),
    ("PUT", "/v1/worlds/aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa", "", 422, "invalid_world_name", None),
    ("PUT", "@", "{}", 409, "world_exists", None),
    // Not JSON.
    ("PUT", "@/particles/0/mass", "", 400, "malformed_json", None),
    ("PUT", "@/particles/0/mass", "{\"mass\":2", 400, "malformed_json", None),
    ("PUT", "@/particles/0/mass", "{\"mass\":2} x", 400, "malformed_json", None),
    ("PUT", "@/particles/0/mass", "{\"mass\":NaN}", 400, "malformed_json", None),
    ("PUT", "@/particles/0/mass", "{\"mass\":Infinity}", 400, "malformed_json", None),
    ("PUT", "@/particles/0/mass", "{\"mass\":+1}", 400, "malformed_json", None),
    ("PUT", "@/particles/0/mass", "{\"mass\":01}", 400, "malformed_json", None),
    ("PUT", "@/particles/0/mass", "{'mass':1}", 400, "malformed_json", None),
    ("PUT", "@/particles/0/mass", "\u{feff}{\"mass\":1}", 400, "malformed_json", None),
    ("PUT", "@/particles/0/mass", "mass=1", 400, "malformed_json", None),
    ("POST", "@/advance", "{\"duration\":\"x\" \"steps\":1}", 400, "malformed_json", None),
    ("POST", "@/particles", "[{},", 400, "malformed_json", None),
    ("PUT", "/v1/worlds/fresh", "{", 400, "malformed_json", None),
    // Shapes.
    ("PUT", "@/particles/0/mass", "[1]", 422, "invalid_field", Some("")),
    ("PUT", "@/particles/0/mass", "1", 422, "invalid_field", Some("")),
    ("PUT", "@/particles/0/mass", "null", 422, "invalid_field", Some("")),
    ("PUT", "@/particles/0/mass", "{\"mass\":\"1\"}", 422, "invalid_field", Some("/mass")),
    ("PUT", "@/particles/0/mass", "{\"mass\":true}", 422, "invalid_field", Some("/mass")),
    ("PUT", "@/particles/0/mass", "{\"mass\":null}", 422, "invalid_field", Some("/mass")),
    ("PUT", "@/particles/0/mass", "{\"mass\":[1]}", 422, "invalid_field", Some("/mass")),
    ("PUT", "@/particles/0/mass", "{\"Mass\":1}", 422, "unknown_field", Some("/Mass")),
    ("PUT", "@/particles/0/mass", "{\"mass\":1,\"mass\":1}", 422, "duplicate_field", Some("/mass")),
    ("PUT", "@/particles/0/mass", "{\"mass\":1,\"~a/b\":1}", 422, "unknown_field", Some("/~0a~1b")),
    ("PUT", "@/particles/0/mass", "{}", 422, "missing_field", None),
    ("PUT", "@/particles/0/mass", "{\"mass\":2,\"inverse_mass\":0.5}", 422, "mass_and_inverse_mass", Some("/inverse_mass")),
    ("POST", "@/particles", "{\"position\":[1,2]}", 422, "invalid_field", Some("/position")),
    ("POST", "@/particles", "{\"position\":[1,2,3,4]}", 422, "invalid_field", Some("/position")),
    ("POST", "@/particles", "{\"position\":[1,null,3]}", 422, "invalid_field", Some("/position/1")),
    ("POST", "@/particles", "{\"position\":{\"x\":1}}", 422, "invalid_field", Some("/position")),
    ("POST", "@/particles", "{\"position\":null}", 422, "invalid_field", Some("/position")),
    ("POST", "@/particles", "{\"id\":7}", 422, "unknown_field", Some("/id")),
    ("POST", "@/particles", "{\"position\":[[1,2,3]]}", 422, "invalid_field", Some("/position/0")),
    ("POST", "@/particles", "[{},[]]", 422, "invalid_field", Some("/1")),
    ("POST", "@/particles", "[{},{\"count\":1}]", 422, "unknown_field", Some("/1/count")),
    ("POST", "@/particles", "{\"count\":-1}", 422, "invalid_field", Some("/count")),
    ("POST", "@/particles", "{\"count\":1.5}", 422, "invalid_field", Some("/count")),
    ("POST", "@/particles", "{\"count\":2,\"position\":[[1,2,3],[1,2]]}", 422, "invalid_field", Some("/position/1")),
    ("POST", "@/particles", "{\"count\":2,\"damping\":[1,\"x\"]}", 422, "invalid_field", Some("/damping/1")),
    ("POST", "@/particles", "{\"count\":2,\"mass\":[1,null]}", 422, "invalid_field", Some("/mass/1")),
    ("POST", "@/particles/0/force", "{}", 422, "missing_field", Some("/force")),
    ("POST", "@/particles/0/force", "{\"force\":5}", 422, "invalid_field", Some("/force")),
    ("POST", "@/particles/0/impulse", "{\"force\":[1,0,0]}", 422, "unknown_field", Some("/force")),
    ("POST", "@/particles/0/place", "{}", 422, "missing_field", None),
    ("POST", "@/forces", "{\"ids\":[0.0],\"force\":[1,0,0]}", 422, "invalid_field", Some("/ids/0")),
    ("POST", "@/forces", "{\"ids\":[0]}", 422, "missing_field", Some("/force")),
    ("POST", "@/forces", "{\"ids\":null,\"force\":[1,0,0]}", 422, "invalid_field", Some("/ids")),
    ("POST", "@/forces", "{\"force\":[[1,0,0],[1,0,0]]}", 422, "length_mismatch", Some("/force")),
    ("POST", "@/advance", "{}", 422, "missing_field", Some("/duration")),
    ("POST", "@/advance", "{\"duration\":1,\"steps\":1.0}", 422, "invalid_field", Some("/steps")),
    ("POST", "@/advance", "{\"duration\":1,\"steps\":null}", 422, "invalid_field", Some("/steps")),
    ("POST", "@/advance", "{\"duration\":1,\"return\":[\"speed\"]}", 422, "invalid_field", Some("/return/0")),
    ("POST", "@/advance", "{\"duration\":1,\"dry_run\":1}", 422, "invalid_field", Some("/dry_run")),
    ("PUT", "/v1/worlds/fresh", "{\"precision\":\"half\"}", 422, "invalid_field", Some("/precision")),
    ("PUT", "/v1/worlds/fresh", "{\"integrator\":\"euler\"}", 422, "invalid_field", Some("/integrator")),
    ("PUT", "/v1/worlds/fresh", "{\"gravity\":\"moon\"}", 422, "invalid_field", Some("/gravity")),
    ("PUT", "/v1/worlds/fresh", "{\"gravity\":[0,-10]}", 422, "invalid_field", Some("/gravity")),
    ("PUT", "/v1/worlds/fresh", "{\"gravity\":null}", 422, "invalid_field", Some("/gravity")),
    ("PUT", "/v1/worlds/fresh", "{\"name\":\"x\"}", 422, "unknown_field", Some("/name")),
    ("POST", "/v1/worlds", "[]", 422, "invalid_field", Some("")),
    ("PATCH", "@", "{\"precision\":\"single\"}", 422, "unknown_field", Some("/precision")),
    ("PATCH", "@", "{\"max_step\":\"x\"}", 422, "invalid_field", Some("/max_step")),
    ("PATCH", "@/particles/0", "{\"position\":[1,2,3]}", 422, "integrator_owns_field", Some("/position")),
    ("PATCH", "@/particles/0", "{\"velocity\":[1,2,3]}", 422, "integrator_owns_field", Some("/velocity")),
    ("PATCH", "@/particles", "{\"velocity\":[1,2,3]}", 422, "integrator_owns_field", Some("/velocity")),
    ("PATCH", "@/particles/0", "{\"mass\":1,\"inverse_mass\":1}", 422, "mass_and_inverse_mass", Some("/inverse_mass")),
    ("PATCH", "@/particles", "{\"mass\":1,\"inverse_mass\":[1,1,1]}", 422, "mass_and_inverse_mass", Some("/inverse_mass")),
    ("POST", "@/particles", "[{},{\"mass\":1,\"inverse_mass\":1}]", 422, "mass_and_inverse_mass", Some("/1/inverse_mass")),
    // Numbers.
    ("PUT", "@/particles/0/mass", "{\"mass\":0}", 422, "mass_not_positive", Some("/mass")),
    ("PUT", "@/particles/0/mass", "{\"mass\":-0.0}", 422, "mass_not_positive", Some("/mass")),
    ("PUT", "@/particles/0/mass", "{\"mass\":-2}", 422, "mass_not_positive", Some("/mass")),
    ("PUT", "@/particles/0/mass", "{\"mass\":1e-309}", 422, "not_finite", Some("/mass")),
    ("PUT", "@/particles/0/mass", "{\"mass\":1e400}", 422, "not_finite", Some("/mass")),
    ("PUT", "@/particles/0/mass", "{\"inverse_mass\":-1}", 422, "inverse_mass_negative", Some("/inverse_mass")),
    ("PUT", "%/particles/0/mass", "{\"mass\":1e39}", 422, "not_finite", Some("/mass")),
    ("PUT", "%/particles/0/mass", "{\"mass\":1e-40}", 422, "not_finite", Some("/mass")),
    ("POST", "@/particles", "{\"position\":[0,1e999,0]}", 422, "not_finite", Some("/position/1")),
    ("POST", "%/particles", "{\"position\":[0,1e39,0]}", 422, "not_finite", Some("/position/1")),
    ("POST", "%/particles", "{\"count\":2,\"velocity\":[[0,0,0],[0,-1e39,0]]}", 422, "not_finite", Some("/velocity/1/1")),
    ("POST", "@/particles", "{\"mass\":0}", 422, "mass_not_positive", Some("/mass")),
    ("POST", "@/particles", "{\"damping\":1.0000000000000002}", 422, "damping_out_of_range", Some("/damping")),
    ("POST", "@/particles", "{\"damping\":-1e-300}", 422, "damping_out_of_range", Some("/damping")),
    ("POST", "@/particles", "[{},{\"damping\":2}]", 422, "damping_out_of_range", Some("/1/damping")),
    ("POST", "@/particles", "[{},{\"mass\":-1}]", 422, "mass_not_positive", Some("/1/mass")),
    ("POST", "@/particles", "{\"count\":3,\"damping\":[1,0.5,2]}", 422, "damping_out_of_range", Some("/damping/2")),
    ("POST", "@/particles", "{\"count\":3,\"mass\":[1,2]}", 422, "length_mismatch", Some("/mass")),
    ("POST", "@/particles", "{\"count\":3,\"position\":[]}", 422, "length_mismatch", Some("/position")),
    ("PATCH", "@/particles", "{\"damping\":[1,1]}", 422, "length_mismatch", Some("/damping")),
    ("PATCH", "@/particles", "{\"ids\":[0,1],\"mass\":[1,0]}", 422, "mass_not_positive", Some("/mass/1")),
    ("PATCH", "@/particles/0", "{\"damping\":7}", 422, "damping_out_of_range", Some("/damping")),
    ("PATCH", "@/particles/0", "{\"acceleration\":[0,1e400,0]}", 422, "not_finite", Some("/acceleration/1")),
    ("POST", "@/forces", "{\"ids\":[0,1],\"force\":[[1,0,0]]}", 422, "length_mismatch", Some("/force")),
    ("POST", "@/forces", "{\"ids\":[0,0],\"force\":[1e308,0,0]}", 422, "not_finite", Some("/force")),
    ("POST", "@/particles/0/impulse", "{\"impulse\":[1e400,0,0]}", 422, "not_finite", Some("/impulse/0")),
    ("POST", "@/particles/1/impulse", "{\"impulse\":[1e308,0,0]}", 422, "not_finite", Some("/impulse")),
    // Time.
    ("POST", "@/advance", "{\"duration\":0}", 422, "duration_not_positive", Some("/duration")),
    ("POST", "@/advance", "{\"duration\":-0.0}", 422, "duration_not_positive", Some("/duration")),
    ("POST", "@/advance", "{\"duration\":-1}", 422, "duration_not_positive", Some("/duration")),
    ("POST", "@/advance", "{\"duration\":1e400}", 422, "not_finite", Some("/duration")),
    ("POST", "@/advance", "{\"duration\":1e200}", 422, "clock_out_of_range", Some("/duration")),
    ("POST", "%/advance", "{\"duration\":1e39}", 422, "not_finite", Some("/duration")),
    ("POST", "@/advance", "{\"duration\":1,\"steps\":0}", 422, "steps_not_positive", Some("/steps")),
    ("POST", "@/advance", "{\"duration\":1,\"steps\":2,\"max_step\":1}", 422, "steps_and_max_step", Some("/max_step")),
    ("POST", "@/advance", "{\"duration\":1,\"max_step\":0}", 422, "max_step_not_positive", Some("/max_step")),
    ("POST", "@/advance", "{\"duration\":1,\"steps\":1000001}", 422, "compute_budget", Some("/steps")),
    ("POST", "@/advance", "{\"duration\":1,\"max_step\":1e-7}", 422, "compute_budget", Some("/max_step")),
    ("POST", "@/advance", "{\"duration\":1,\"max_step\":5e-324}", 422, "compute_budget", Some("/max_step")),
    ("POST", "@/advance", "{\"duration\":1e100,\"steps\":4}", 422, "diverged", None),
    ("POST", "%/advance", "{\"duration\":1e30}", 422, "diverged", None),
    ("PATCH", "@", "{\"max_step\":0}", 422, "max_step_not_positive", Some("/max_step")),
    ("PATCH", "@", "{\"max_step\":-1}", 422, "max_step_not_positive", Some("/max_step")),
    ("PATCH", "@", "{\"damping_law\":\"per_step\",\"integrator\":\"exact\"}", 422, "integrator_cannot_serve_damping", Some("/damping_law")),
    ("PUT", "/v1/worlds/fresh", "{\"damping_law\":\"per_step\"}", 422, "integrator_cannot_serve_damping", Some("/damping_law")),
    ("PUT", "/v1/worlds/fresh", "{\"max_step\":0}", 422, "max_step_not_positive", Some("/max_step")),
    // Forces.
    ("PUT", "/v1/worlds/fresh", "{\"forces\":{\"drag\":{}}}", 422, "integrator_cannot_serve_forces", Some("/forces/drag")),
    ("PATCH", "@", "{\"forces\":{\"gravitation\":{}},\"integrator\":\"exact\"}", 422, "integrator_cannot_serve_forces", Some("/forces/gravitation")),
    ("PATCH", "~", "{\"integrator\":\"exact\"}", 422, "integrator_cannot_serve_forces", Some("/integrator")),
    ("PATCH", "~", "{\"integrator\":\"exact\",\"forces\":{\"drag\":null}}", 422, "integrator_cannot_serve_forces", Some("/integrator")),
    ("PUT", "/v1/worlds/fresh", "{\"forces\":1}", 422, "invalid_field", Some("/forces")),
    ("PUT", "/v1/worlds/fresh", "{\"forces\":[null,null]}", 422, "invalid_field", Some("/forces")),
    ("PUT", "/v1/worlds/fresh", "{\"forces\":{\"wind\":{}}}", 422, "unknown_field", Some("/forces/wind")),
    ("PUT", "/v1/worlds/fresh", "{\"forces\":{\"drag\":[1,2]}}", 422, "invalid_field", Some("/forces/drag")),
    ("PUT", "/v1/worlds/fresh", "{\"forces\":{\"drag\":{\"k3\":1}}}", 422, "unknown_field", Some("/forces/drag/k3")),
    ("PUT", "/v1/worlds/fresh", "{\"forces\":{\"drag\":{\"k1\":null}}}", 422, "invalid_field", Some("/forces/drag/k1")),
    ("PUT", "/v1/worlds/fresh", "{\"forces\":{\"drag\":{\"k1\":1,\"k1\":1}}}", 422, "duplicate_field", Some("/forces/drag/k1")),
    ("PUT", "/v1/worlds/fresh", "{\"forces\":{\"drag\":{\"k1\":-1}}}", 422, "negative_value", Some("/forces/drag/k1")),
    ("PUT", "/v1/worlds/fresh", "{\"forces\":{\"drag\":{\"k2\":1e400}}}", 422, "not_finite", Some("/forces/drag/k2")),
    ("PUT", "/v1/worlds/fresh", "{\"precision\":\"single\",\"forces\":{\"drag\":{\"k2\":1e39}}}", 422, "not_finite", Some("/forces/drag/k2")),
    ("PATCH", "@", "{\"forces\":{\"drag\":{\"k2\":-1}}}", 422, "negative_value", Some("/forces/drag/k2")),
    ("PATCH", "@", "{\"forces\":{\"gravitation\":{\"constant\":-1}}}", 422, "negative_value", Some("/forces/gravitation/constant")),
    ("PATCH", "@", "{\"forces\":{\"gravitation\":{\"softening\":-1}}}", 422, "negative_value", Some("/forces/gravitation/softening")),
    ("PATCH", "%", "{\"forces\":{\"gravitation\":{\"softening\":1e39}}}", 422, "not_finite", Some("/forces/gravitation/softening")),
    ("PATCH", "@", "{\"tolerance\":null}", 422, "invalid_field", Some("/tolerance")),
    ("PATCH", "@", "{\"tolerance\":1e-9}", 422, "invalid_field", Some("/tolerance")),
    ("PATCH", "@", "{\"tolerance\":{\"both\":1}}", 422, "unknown_field", Some("/tolerance/both")),
    ("PATCH", "@", "{\"tolerance\":{\"absolute\":-1}}", 422, "negative_value", Some("/tolerance/absolute")),
    ("PATCH", "@", "{\"tolerance\":{\"relative\":-1}}", 422, "negative_value", Some("/tolerance/relative")),
    ("PATCH", "@", "{\"tolerance\":{\"relative\":1e400}}", 422, "not_finite", Some("/tolerance/relative")),
    ("PUT", "/v1/worlds/fresh", "{\"tolerance\":{\"absolute\":0,\"relative\":0}}", 422, "invalid_field", Some("/tolerance")),
    ("PUT", "/v1/worlds/fresh", "{\"compensated\":1}", 422, "invalid_field", Some("/compensated")),
    ("PATCH", "@", "{\"compensated\":null}", 422, "invalid_field", Some("/compensated")),
    ("POST", "@/particles", "{\"drag\":[1]}", 422, "invalid_field", Some("/drag")),
    ("POST", "@/particles", "{\"drag\":[1,2,3]}", 422, "invalid_field", Some("/drag")),
    ("POST", "@/particles", "{\"drag\":0.5}", 422, "invalid_field", Some("/drag")),
    ("POST", "@/particles", "{\"drag\":{\"k1\":1}}", 422, "invalid_field", Some("/drag")),
    ("POST", "@/particles", "{\"drag\":[1,null]}", 422, "invalid_field", Some("/drag/1")),
    ("POST", "@/particles", "{\"drag\":[0,1e400]}", 422, "not_finite", Some("/drag/1")),
    ("POST", "@/particles", "{\"drag\":[0,-1]}", 422, "negative_value", Some("/drag")),
    ("POST", "@/particles", "[{},{\"drag\":[-1,0]}]", 422, "negative_value", Some("/1/drag")),
    ("POST", "@/particles", "{\"count\":3,\"drag\":[-1,0]}", 422, "negative_value", Some("/drag")),
    ("POST", "@/particles", "{\"count\":3,\"drag\":[[1,1],null,[0,-1]]}", 422, "negative_value", Some("/drag/2")),
    ("POST", "@/particles", "{\"count\":3,\"drag\":[[1,1]]}", 422, "length_mismatch", Some("/drag")),
    ("POST", "@/particles", "{\"count\":2,\"drag\":[1,[1,1]]}", 422, "invalid_field", Some("/drag/1")),
    ("POST", "@/particles", "{\"gravitational_mass\":\"1\"}", 422, "invalid_field", Some("/gravitational_mass")),
    ("POST", "@/particles", "{\"gravitational_mass\":-1}", 422, "negative_value", Some("/gravitational_mass")),
    ("POST", "%/particles", "{\"gravitational_mass\":1e39}", 422, "not_finite", Some("/gravitational_mass")),
    ("POST", "@/particles", "[{},{\"gravitational_mass\":-1}]", 422, "negative_value", Some("/1/gravitational_mass")),
    ("POST", "@/particles", "{\"count\":2,\"gravitational_mass\":[null,-1]}", 422, "negative_value", Some("/gravitational_mass/1")),
    ("POST", "@/particles", "{\"count\":2,\"gravitational_mass\":[1]}", 422, "length_mismatch", Some("/gravitational_mass")),
    ("PATCH", "@/particles/0", "{\"drag\":[-1,0]}", 422, "negative_value", Some("/drag")),
    ("PATCH", "@/particles/0", "{\"gravitational_mass\":-1}", 422, "negative_value", Some("/gravitational_mass")),
    ("PATCH", "@/particles", "{\"ids\":[0,1],\"drag\":[[1,1],[-1,1]]}", 422, "negative_value", Some("/drag/1")),
    ("PATCH", "@/particles", "{\"ids\":[0,1],\"gravitational_mass\":[1,-1]}", 422, "negative_value", Some("/gravitational_mass/1")),
    ("POST", "~/particles", "[{},{\"damping\":0}]", 422, "integrator_cannot_serve_damping", Some("/1/damping")),
    ("PATCH", "~/particles", "{\"damping\":[1,0]}", 422, "integrator_cannot_serve_damping", Some("/damping/1")),
    ("PATCH", "~/particles/0", "{\"damping\":0}", 422, "integrator_cannot_serve_damping", Some("/damping")),
    ("PATCH", "@", "{\"integrator\":\"rk4\",\"damping_law\":\"per_step\"}", 422, "integrator_cannot_serve_damping", Some("/damping_law")),
    ("POST", "~/advance", "{\"duration\":1,\"steps\":2}", 422, "integrator_takes_no_steps", Some("/steps")),
    ("POST", "@/advance", "{\"duration\":1,\"report_error\":1}", 422, "invalid_field", Some("/report_error")),
    ("POST", "@/advance", "{\"duration\":1,\"until\":null}", 422, "invalid_field", Some("/until")),
    ("POST", "@/advance", "{\"duration\":1,\"until\":[0]}", 422, "invalid_field", Some("/until")),
    ("POST", "@/advance", "{\"duration\":1,\"until\":{\"plane\":{\"normal\":[0,1,0]}}}", 422, "missing_field", Some("/until/particle")),
    ("POST", "@/advance", "{\"duration\":1,\"until\":{\"particle\":0}}", 422, "missing_field", Some("/until/plane")),
    ("POST", "@/advance", "{\"duration\":1,\"until\":{\"particle\":0,\"plane\":{}}}", 422, "missing_field", Some("/until/plane/normal")),
    ("POST", "@/advance", "{\"duration\":1,\"until\":{\"particle\":0,\"plane\":{\"normal\":[0,1]}}}", 422, "invalid_field", Some("/until/plane/normal")),
    ("POST", "@/advance", "{\"duration\":1,\"until\":{\"particle\":0,\"plane\":{\"normal\":[0,0,0]}}}", 422, "invalid_field", Some("/until/plane/normal")),
    ("POST", "@/advance", "{\"duration\":1,\"until\":{\"particle\":0,\"plane\":{\"normal\":[0,1e400,0]}}}", 422, "not_finite", Some("/until/plane/normal/1")),
    ("POST", "@/advance", "{\"duration\":1,\"until\":{\"particle\":0,\"plane\":{\"normal\":[0,1,0],\"offset\":null}}}", 422, "invalid_field", Some("/until/plane/offset")),
    ("POST", "@/advance", "{\"duration\":1,\"until\":{\"particle\":0,\"plane\":{\"normal\":[0,1,0],\"offset\":1e400}}}", 422, "not_finite", Some("/until/plane/offset")),
    ("POST", "@/advance", "{\"duration\":1,\"until\":{\"particle\":0,\"plane\":{\"normal\":[0,1,0],\"d\":0}}}", 422, "unknown_field", Some("/until/plane/d")),
    ("POST", "@/advance", "{\"duration\":1,\"until\":{\"particle\":3,\"plane\":{\"normal\":[0,1,0]}}}", 404, "unknown_particle", Some("/until/particle")),
    ("POST", "@/advance", "{\"duration\":1,\"dry_run\":true,\"until\":{\"particle\":3,\"plane\":{\"normal\":[0,1,0]}}}", 404, "unknown_particle", Some("/until/particle")),
    // Commands.
    ("POST", "/v1/worlds/nowhere/commands", "{", 404, "unknown_world", None),
    ("POST", "@/commands", "{\"commands\":[{]}", 400, "malformed_json", None),
    ("POST", "@/commands", "[]", 422, "invalid_field", Some("")),
    ("POST", "@/commands", "{}", 422, "missing_field", Some("/commands")),
    ("POST", "@/commands", "{\"commands\":{}}", 422, "invalid_field", Some("/commands")),
    ("POST", "@/commands", "{\"commands\":[],\"if\":1}", 422, "unknown_field", Some("/if")),
    ("POST", "@/commands", "{\"commands\":[{}]}", 422, "invalid_field", Some("/commands/0")),
    ("POST", "@/commands", "{\"commands\":[[]]}", 422, "invalid_field", Some("/commands/0")),
    ("POST", "@/commands", "{\"commands\":[\"read\"]}", 422, "invalid_field", Some("/commands/0")),
    ("POST", "@/commands", "{\"commands\":[{\"read\":{}},{\"read\":{},\"set\":{}}]}", 422, "invalid_field", Some("/commands/1")),
    ("POST", "@/commands", "{\"commands\":[{\"jump\":{}}]}", 422, "unknown_field", Some("/commands/0/jump")),
    ("POST", "@/commands", "{\"commands\":[{\"read\":{},\"read\":{}}]}", 422, "duplicate_field", Some("/commands/0/read")),
    ("POST", "@/commands", "{\"commands\":[{\"read\":null}]}", 422, "invalid_field", Some("/commands/0/read")),
    ("POST", "@/commands", "{\"commands\":[{\"read\":{\"fields\":[\"speed\"]}}]}", 422, "invalid_field", Some("/commands/0/read/fields/0")),
    ("POST", "@/commands", "{\"commands\":[{\"read\":{\"ids\":[0,3]}}]}", 404, "unknown_particle", Some("/commands/0/read/ids/1")),
    ("POST", "@/commands", "{\"commands\":[{\"add_force\":{\"ids\":[\"0\"],\"force\":[1,0,0]}}]}", 422, "invalid_field", Some("/commands/0/add_force/ids/0")),
    ("POST", "@/commands", "{\"commands\":[{\"add_force\":{\"ids\":[0],\"force\":[[1,0]]}}]}", 422, "invalid_field", Some("/commands/0/add_force/force/0")),
    ("POST", "@/commands", "{\"commands\":[{\"add_force\":[[0],[1,0,0]]}]}", 422, "invalid_field", Some("/commands/0/add_force")),
    ("POST", "@/commands", "{\"commands\":[{\"add_force\":{\"ids\":[0]}}]}", 422, "missing_field", Some("/commands/0/add_force/force")),
    ("POST", "@/commands", "{\"commands\":[{\"read\":{}},{\"impulse\":{\"ids\":[1],\"impulse\":[1e308,0,0]}}]}", 422, "not_finite", Some("/commands/1/impulse/impulse")),
    ("POST", "%/commands", "{\"commands\":[{\"place\":{\"ids\":[0],\"position\":[0,1e39,0]}}]}", 422, "not_finite", Some("/commands/0/place/position/1")),
    ("POST", "@/commands", "{\"commands\":[{\"place\":{\"ids\":[0]}}]}", 422, "missing_field", Some("/commands/0/place")),
    ("POST", "@/commands", "{\"commands\":[{\"set\":{\"position\":[0,0,0]}}]}", 422, "integrator_owns_field", Some("/commands/0/set/position")),
    ("POST", "@/commands", "{\"commands\":[{\"set\":{\"mass\":1,\"inverse_mass\":1}}]}", 422, "mass_and_inverse_mass", Some("/commands/0/set/inverse_mass")),
    ("POST", "@/commands", "{\"commands\":[{\"create\":{}},{\"create\":[{},{\"mass\":1,\"mass\":1}]}]}", 422, "duplicate_field", Some("/commands/1/create/1/mass")),
    ("POST", "@/commands", "{\"commands\":[{\"create\":{\"count\":2,\"mass\":[1]}}]}", 422, "length_mismatch", Some("/commands/0/create/mass")),
    ("POST", "@/commands", "{\"commands\":[{\"create\":{\"count\":6}}]}", 422, "limit_reached", Some("/commands/0/create/count")),
    ("POST", "@/commands", "{\"commands\":[{\"create\":{\"count\":5}},{\"create\":{}}]}", 422, "limit_reached", Some("/commands/1/create")),
    ("POST", "@/commands", "{\"commands\":[{\"add_force\":{\"force\":[[1,0,0]]}}]}", 422, "length_mismatch", Some("/commands/0/add_force/force")),
    ("POST", "@/commands", "{\"commands\":[{\"impulse\":{\"impulse\":[]}}]}", 422, "length_mismatch", Some("/commands/0/impulse/impulse")),
    ("POST", "@/commands", "{\"commands\":[{\"impulse\":{\"ids\":null,\"impulse\":[1,0,0]}}]}", 422, "invalid_field", Some("/commands/0/impulse/ids")),
    ("POST", "@/commands", "{\"commands\":[{\"place\":{\"position\":[0,0,0],\"velocity\":[[1,0,0]]}}]}", 422, "length_mismatch", Some("/commands/0/place/velocity")),
    ("POST", "@/commands", "{\"commands\":[{\"place\":{}}]}", 422, "missing_field", Some("/commands/0/place")),
    ("POST", "@/commands", "{\"commands\":[{\"remove\":{}}]}", 422, "missing_field", Some("/commands/0/remove/ids")),
    ("POST", "@/commands", "{\"commands\":[{\"remove\":{\"ids\":null}}]}", 422, "invalid_field", Some("/commands/0/remove/ids")),
    ("POST", "@/commands", "{\"commands\":[{\"remove\":{\"ids\":[0,1,0]}}]}", 422, "removed_twice", Some("/commands/0/remove/ids/2")),
    ("POST", "@/commands", "{\"commands\":[{\"remove\":{\"ids\":[0]}},{\"read\":{\"ids\":[0]}}]}", 404, "unknown_particle", Some("/commands/1/read/ids/0")),
    ("POST", "@/commands", "{\"commands\":[{\"advance\":{\"duration\":1,\"dry_run\":true}}]}", 422, "invalid_field", Some("/commands/0/advance/dry_run")),
    ("POST", "@/commands", "{\"commands\":[{\"advance\":{\"duration\":1}},{\"advance\":{\"duration\":-1}}]}", 422, "duration_not_positive", Some("/commands/1/advance/duration")),
    ("POST", "@/commands?x=1", "{\"commands\":[]}", 422, "invalid_parameter", None),
    ("POST", "/v1/commands", "{\"worlds\":", 400, "malformed_json", None),
    ("POST", "/v1/commands", "{}", 422, "missing_field", Some("/worlds")),
    ("POST", "/v1/commands", "{\"worlds\":[]}", 422, "invalid_field", Some("/worlds")),
    ("POST", "/v1/commands", "{\"worlds\":{\"double\":{\"commands\":[]},\"double\":{\"commands\":[]}}}", 422, "duplicate_field", Some("/worlds/double")),
    ("POST", "/v1/commands", "{\"worlds\":{\"a\":{},\"b\":{},\"c\":{},\"d\":{}}}", 422, "limit_reached", Some("/worlds")),
    ("POST", "/v1/commands?x=1", "{\"worlds\":{}}", 422, "invalid_parameter", None),
    ("GET", "/v1/commands", "", 405, "method_not_allowed", None),
    // Trajectories.
    ("POST", "@/particles/0/trajectory", "{}", 405, "method_not_allowed", None),
    ("GET", "/v1/worlds/nowhere/particles/0/trajectory", "", 404, "unknown_world", None),
    ("GET", "@/particles/3/trajectory?duration=1", "", 404, "unknown_particle", None),
    ("GET", "@/particles/00/trajectory?samples=x", "", 404, "unknown_particle", None),
    ("GET", "@/particles/0/trajectory", "", 422, "invalid_parameter", None),
    ("GET", "@/particles/0/trajectory?duration=x", "", 422, "invalid_parameter", None),
    ("GET", "@/particles/0/trajectory?duration=1&duration=1", "", 422, "invalid_parameter", None),
    ("GET", "@/particles/0/trajectory?duration=1&steps=1", "", 422, "invalid_parameter", None),
    ("GET", "@/particles/0/trajectory?duration=1&samples=1", "", 422, "invalid_parameter", None),
    ("GET", "@/particles/0/trajectory?duration=1&samples=2.5", "", 422, "invalid_parameter", None),
    ("GET", "@/particles/0/trajectory?duration=1&samples=100001", "", 422, "invalid_parameter", None),
    ("GET", "@/particles/0/trajectory?duration=0", "", 422, "duration_not_positive", None),
    ("GET", "@/particles/0/trajectory?duration=-1", "", 422, "duration_not_positive", None),
    ("GET", "@/particles/0/trajectory?duration=1e400", "", 422, "not_finite", None),
    ("GET", "%/particles/0/trajectory?duration=1e39", "", 422, "not_finite", None),
    ("GET", "@/particles/0/trajectory?duration=1e200", "", 422, "clock_out_of_range", None),
    ("GET", "~/particles/0/trajectory?duration=1", "", 422, "compute_budget", None),
    // Limits: 8 particles, 3 worlds, 4096 bytes, 40 interactions in the service of this test.
    ("POST", "~/advance", "{\"duration\":1}", 422, "compute_budget", Some("/duration")),
    ("POST", "@/particles", "{\"count\":6}", 422, "limit_reached", Some("/count")),
    ("POST", "@/particles", "{\"count\":1000000000000}", 422, "limit_reached", None),
    ("POST", "@/particles", "[{},{},{},{},{},{}]", 422, "limit_reached", None),
    ("POST", "@/commands", "{\"commands\":[{\"advance\":{\"duration\":1,\"steps\":1000001}}]}", 422, "compute_budget", Some("/commands/0/advance/steps")),
    ("PUT", "/v1/worlds/third", "", 422, "limit_reached", None),
    // Query parameters.
    ("GET", "@?x=1", "", 422, "invalid_parameter", None),
    ("GET", "@/digest?x=1", "", 422, "invalid_parameter", None),
    ("GET", "/v1?x=1", "", 422, "invalid_parameter", None),
    ("GET", "/healthz?x=1", "", 422, "invalid_parameter", None),
    ("GET", "/metrics?x=1", "", 422, "invalid_parameter", None),
    ("GET", "@/state?fields=speed", "", 422, "invalid_parameter", None),
    ("GET", "@/state?fields=", "", 422, "invalid_parameter", None),
    ("GET", "@/state?limit=1", "", 422, "invalid_parameter", None),
    ("GET", "@/particles?limit=0", "", 422, "invalid_parameter", None),
    ("GET", "@/particles?limit=100001", "", 422, "invalid_parameter", None),
    ("GET", "@/particles?limit=1&limit=1", "", 422, "invalid_parameter", None),
    ("GET", "@/particles?ids=a", "", 422, "invalid_parameter", None),
    ("GET", "@/particles?after=-1", "", 422, "invalid_parameter", None),
    ("POST", "@/advance?x=1", "{\"duration\":1}", 422, "invalid_parameter", None),
    ("DELETE", "@?force=1", "", 422, "invalid_parameter", None),
    ("PUT", "/v1/worlds/fresh?x=1", "", 422, "invalid_parameter", None),
    ("GET", "/v1/worlds?limit=0", "", 422, "invalid_parameter", None),
];

/// Method, path, body, and the sentence that says what to do instead.
#[rustfmt::skip]
const SENTENCES: &[(&str, &str, &str, &str)] = &[
    ("PUT", "@", "{}", "there is a world \"double\" already; change its settings with PATCH, or DELETE it first"),
    ("PUT", "/v1/worlds/fresh", "{\"name\":\"x\"}", "the name of a world stands in the path: create it with PUT /v1/worlds/{world}"),
    ("POST", "/v1/worlds", "{\"name\":\"x\"}", "the name of a world stands in the path: create it with PUT /v1/worlds/{world}"),
    ("POST", "/v1/worlds", "{\"gravity\":\"textbook\",\"world\":\"x\"}", "the name of a world stands in the path: create it with PUT /v1/worlds/{world}"),
    ("PUT", "/v1/worlds/third", "", "there are 3 worlds, the most allowed (--worlds-max); delete one"),
    ("PUT", "/v1/worlds", "{}", "PUT is not a method of this path; it has GET, HEAD, POST"),
    ("GET", "@/forces", "", "GET is not a method of this path; it has POST"),
    ("POST", "@/particles", "{\"position\":[[0,0,0],[1,1,1]]}", "invalid type: sequence, expected a number; columns, with a value for each particle, need a count"),
    ("POST", "@/particles", "{\"mass\":[1,2]}", "invalid type: sequence, expected a number; columns, with a value for each particle, need a count"),
    ("POST", "@/particles", "{\"mass\":\"1\"}", "invalid type: string \"1\", expected a number at line 1 column 11"),
    ("POST", "@/commands", "{\"commands\":[{\"create\":{\"position\":[[0,0,0]]}}]}", "invalid type: sequence, expected a number; columns, with a value for each particle, need a count"),
    ("POST", "@/forces", "{\"force\":[[1,0,0],[1,0,0]]}", "force has 2 values for 3 particles; give one for each, or a single value for all"),
    ("PUT", "/v1/worlds/fresh", "{\"forces\":{\"drag\":{}}}", "the integrator exact cannot serve drag or gravitation; take velocity_verlet, rk4, dop853 or an Euler integrator"),
];

/// Method, headers, status, code: refused before any body is read.
#[rustfmt::skip]
const HEADERS: &[HeaderRow] = &[
    ("GET", &[("host", "evil.example")], 403, "host_not_allowed"),
    ("GET", &[("host", "localhost.evil.example:80")], 403, "host_not_allowed"),
    ("GET", &[("host", "localhost"), ("host", "localhost")], 403, "host_not_allowed"),
    ("PUT", &[("origin", "http://evil.example")], 403, "cross_origin"),
    ("PUT", &[("origin", "null")], 403, "cross_origin"),
    ("PUT", &[("host", "[::1].evil.example")], 403, "host_not_allowed"),
    ("PUT", &[("host", "localhost:8080"), ("origin", "http://localhost:9090")], 403, "cross_origin"),
    ("PUT", &[("host", "localhost:8080"), ("origin", "https://localhost:8080")], 403, "cross_origin"),
    ("GET", &[("sec-fetch-site", "cross-site")], 403, "cross_origin"),
    ("PUT", &[("content-type", "application/cbor")], 400, "malformed_cbor"),
    ("PUT", &[("content-type", "application/cbor-seq")], 415, "unsupported_media_type"),
    ("PUT", &[("content-type", "image/png")], 415, "unsupported_media_type"),
    ("PUT", &[("content-encoding", "gzip")], 415, "unsupported_media_type"),
    ("GET", &[("accept", "text/html")], 406, "not_acceptable"),
    ("GET", &[("accept", "application/json;q=0")], 406, "not_acceptable"),
    ("PUT", &[("if-match", "\"77\"")], 412, "revision_mismatch"),
    ("PUT", &[("if-match", "W/\"5\"")], 412, "revision_mismatch"),
];

fn prepare(service: &Service) -> Client {
    let mut client = service.client();
    for (world, precision, large) in [("double", "double", "1e308"), ("single", "single", "3e38")] {
        let path = format!("/v1/worlds/{world}");
        let settings =
            format!("{{\"integrator\":\"newton_euler\",\"precision\":\"{precision}\",\"gravity\":\"standard\"}}");
        client.put(&path, &settings).expect(201);
        let particles =
            "[{\"damping\":0.5},{\"velocity\":[LARGE,0,0]},{\"inverse_mass\":0},{}]".replace("LARGE", large);
        client.post(&format!("{path}/particles"), &particles).expect(201);
        client.post(&format!("{path}/particles/0/force"), "{\"force\":[1,2,3]}").expect(200);
        client.delete(&format!("{path}/particles/3")).expect(204);
    }
    let settings = "{\"integrator\":\"dop853\",\"forces\":{\"gravitation\":{}}}";
    client.put("/v1/worlds/adaptive", settings).expect(201);
    client.post("/v1/worlds/adaptive/particles", "[{},{\"position\":[1,0,0]}]").expect(201);
    client
}

fn everything(client: &mut Client) -> Vec<String> {
    ["/v1/worlds", "/v1/worlds/double/particles", "/v1/worlds/single/particles", "/v1/worlds/adaptive/particles"]
        .map(|path| client.get(path).expect(200).text().to_owned())
        .to_vec()
}

#[track_caller]
fn check_refused(
    client: &mut Client,
    before: &[String],
    request: (&str, &str, &[(&str, &str)], &str),
    expected: (u16, &str, Option<&str>),
) {
    let (method, path, headers, body) = request;
    let (status, code, pointer) = expected;
    let path =
        path.replace('@', "/v1/worlds/double").replace('%', "/v1/worlds/single").replace('~', "/v1/worlds/adaptive");
    let sent = (method != "GET" && method != "DELETE").then_some(body.as_bytes());
    let answer = client.send(method, &path, headers, sent);
    let context = format!("{method} {path} {headers:?} {body}: {}", answer.text());
    assert_eq!(answer.status, status, "{context}");
    assert_eq!(answer.header("content-type"), Some("application/problem+json"), "{context}");
    let problem: Value = answer.json();
    assert_eq!(problem["code"], code, "{context}");
    assert_eq!(problem["pointer"].as_str(), pointer, "{context}");
    assert_eq!(everything(client), before, "{context} changed something");
}

#[test]
fn refusals_say_why_and_change_nothing() {
    let service = Service::with(|config| {
        config.particles_max = 8;
        config.worlds_max = 3;
        config.interactions_max = 40;
        config.body_bytes_max = 4096;
    });
    let mut client = prepare(&service);
    let before = everything(&mut client);
    for &(method, path, body, status, code, pointer) in ROWS {
        check_refused(&mut client, &before, (method, path, &[], body), (status, code, pointer));
    }
    for &(method, path, body, sentence) in SENTENCES {
        let path = path.replace('@', "/v1/worlds/double");
        let sent = (method != "GET").then_some(body.as_bytes());
        assert_eq!(client.send(method, &path, &[], sent).json()["detail"], sentence, "{method} {path} {body}");
    }
    assert_eq!(everything(&mut client), before);
    for &(method, headers, status, code) in HEADERS {
        let path = if method == "GET" { "@" } else { "@/particles/0/mass" };
        check_refused(&mut client, &before, (method, path, headers, "{\"mass\":3}"), (status, code, None));
    }
    let diverged = client.post("/v1/worlds/double/advance", "{\"duration\":1e100,\"steps\":4}").json();
    let place = [&diverged["particle"], &diverged["quantity"], &diverged["step"]];
    assert_eq!(place.map(ToString::to_string), ["1", "\"position\"", "1"], "{diverged}");
    // What one connection cannot go on after.
    let large = format!("{{\"mass\":{}1}}", " ".repeat(5000));
    for request in [
        format!(
            "PUT /v1/worlds/double/particles/0/mass HTTP/1.1\r\nhost: x.localhost\r\ncontent-length: {}\r\n\r\n{large}",
            large.len()
        ),
        format!(
            "PUT /v1/worlds/double/particles/0/mass HTTP/1.1\r\nhost: localhost\r\ntransfer-encoding: chunked\r\n\r\n{:x}\r\n{large}\r\n0\r\n\r\n",
            large.len()
        ),
        "PUT /v1/worlds/nowhere HTTP/1.1\r\nhost: localhost\r\ncontent-length: 99999999999\r\n\r\n".to_owned(),
    ] {
        let mut client = service.client();
        client.raw(request.as_bytes());
        let answer = client.answer(false);
        assert_eq!((answer.status, answer.json()["code"].as_str()), (413, Some("body_too_large")), "{}", answer.text());
        assert!(answer.text().contains("--body-bytes-max"), "{}", answer.text());
    }
    assert_eq!(everything(&mut client), before);
    // A page that another name leads to has no Host header to tell by in HTTP/1.0.
    let mut old = service.client();
    old.raw(b"PUT /v1/worlds/evil HTTP/1.0\r\norigin: https://evil.example\r\n\r\n");
    assert_eq!(old.answer(false).json()["code"], "cross_origin");
}

/// How large a body may be depends on the route, whatever the world is called.
#[test]
fn each_route_has_its_limit() {
    let (small, bulk, snapshot) = (1 << 20, 3 << 19, 1 << 21);
    let service = Service::with(|config| {
        config.body_bytes_max = bulk;
        config.snapshot_bytes_max = snapshot;
        // What is within its limit, of which nothing is sent, is waited for.
        config.body_timeout_ms = 1;
    });
    let description = service.client().get("/openapi.json").expect(200).json();
    let names = ["demo", "particles", "forces", "commands", "snapshot", "advance", "0"];
    let mut seen = HashSet::new();
    for (template, method, _) in operations(&description) {
        if method == "get" || !template.starts_with("/v1/") {
            continue;
        }
        let limit = match (method.as_str(), template.as_str()) {
            ("post" | "patch", "/v1/worlds/{world}/particles")
            | ("post", "/v1/worlds/{world}/forces" | "/v1/worlds/{world}/commands" | "/v1/commands") => bulk,
            ("put", "/v1/worlds/{world}/snapshot") => snapshot,
            _ => small,
        };
        seen.insert(limit);
        for name in names {
            let path = template.replace("{world}", name).replace("{id}", "0");
            for (length, code) in [(limit, "body_timeout"), (limit + 1, "body_too_large")] {
                let method = method.to_uppercase();
                let mut client = service.client();
                client.raw(
                    format!("{method} {path} HTTP/1.1\r\nhost: localhost\r\ncontent-length: {length}\r\n\r\n")
                        .as_bytes(),
                );
                assert_eq!(client.answer(false).json()["code"], code, "{method} {path} with {length} bytes");
            }
        }
    }
    assert_eq!(seen.len(), 3);
}

/// A 405 says in its sentence which methods there are, as its Allow header does.
#[test]
fn a_method_that_is_not_allowed_is_told_which_are() {
    let service = Service::start();
    let mut client = service.client();
    let description = client.get("/openapi.json").expect(200).json();
    let mut paths: Vec<String> = operations(&description).into_iter().map(|(path, ..)| path).collect();
    paths.dedup();
    for template in paths {
        let path = template.replace("{world}", "forces").replace("{id}", "0");
        let answer = client.send("OPTIONS", &path, &[], None).expect(405);
        let allowed: BTreeSet<&str> = answer.header("allow").expect("the header").split(',').map(str::trim).collect();
        let problem = answer.json();
        let (_, named) = problem["detail"].as_str().and_then(|detail| detail.split_once("; it has ")).expect("methods");
        assert_eq!(named.split(", ").collect::<BTreeSet<_>>(), allowed, "{path}");
    }
}

/// All worlds together have a budget; what is removed is given back.
#[test]
fn memory_is_charged_before_it_is_taken() {
    let service = Service::with(|config| config.memory_bytes_max = 256 * 100);
    let mut client = service.client();
    for world in ["a", "b"] {
        client.put(&format!("/v1/worlds/{world}"), "{\"integrator\":\"newton_euler\"}").expect(201);
    }
    client.post("/v1/worlds/a/particles", "{\"count\":60}").expect(201);
    let refused = client.post("/v1/worlds/b/particles", "{\"count\":41}").expect(422);
    assert_eq!(refused.json()["code"], "limit_reached");
    assert!(refused.text().contains("--memory-bytes-max"), "{}", refused.text());
    client.post("/v1/worlds/b/particles", "{\"count\":40}").expect(201);
    let dry = client.post("/v1/worlds/b/advance", "{\"duration\":1,\"dry_run\":true}").expect(422);
    assert_eq!(dry.json()["code"], "limit_reached", "a dry run works on a copy");
    client.post("/v1/worlds/b/advance", "{\"duration\":1}").expect(200);
    client.delete("/v1/worlds/a").expect(204);
    client.post("/v1/worlds/b/advance", "{\"duration\":1,\"dry_run\":true}").expect(200);
    client.delete("/v1/worlds/b/particles/7").expect(204);
    client.post("/v1/worlds/b/particles", "{\"count\":61}").expect(201);
    client.post("/v1/worlds/b/particles", "{}").expect(422);
}

#[test]
fn answers_and_simulated_seconds_have_a_limit() {
    let service = Service::with(|config| {
        config.answer_bytes_max = 12_000;
        config.duration_max = Some(100.0);
    });
    let mut client = service.client();
    client.put("/v1/worlds/a", "{\"integrator\":\"newton_euler\"}").expect(201);
    client.post("/v1/worlds/a/particles", "{\"count\":100}").expect(201);
    client.get("/v1/worlds/a/state?fields=mass").expect(200);
    client.get("/v1/worlds/a/particles?limit=10").expect(200);
    for path in ["state", "particles", "particles/0/trajectory?duration=1&samples=1000"] {
        let refused = client.get(&format!("/v1/worlds/a/{path}")).expect(422);
        assert_eq!(refused.json()["code"], "answer_too_large", "{path}");
        assert!(refused.text().contains("--answer-bytes-max"), "{}", refused.text());
    }
    let with_state = "{\"duration\":1,\"return\":[\"position\",\"velocity\"]}";
    let refused = client.post("/v1/worlds/a/advance", with_state).expect(422);
    assert_eq!(refused.json()["code"], "answer_too_large");
    client.post("/v1/worlds/a/advance", "{\"duration\":100}").expect(200);
    let refused = client.post("/v1/worlds/a/advance", "{\"duration\":100.5}").expect(422);
    assert_eq!(
        (refused.json()["code"].as_str(), refused.json()["pointer"].as_str()),
        (Some("compute_budget"), Some("/duration"))
    );
    assert!(refused.text().contains("--duration-max"), "{}", refused.text());
    client.get("/v1/worlds/a/particles/0/trajectory?duration=101").expect(422);
    assert_eq!(client.get("/v1/worlds/a").json()["revision"], 2);
}

/// Nothing that is nested deeper than a request can be is ever built: it is skipped in one pass.
#[test]
fn nesting_has_no_price() {
    let service = Service::start();
    let mut client = service.client();
    client.put("/v1/worlds/a", "").expect(201);
    for (open, close) in [("[", "]"), ("{\"a\":", "}")] {
        let inner = if open == "[" { "" } else { "1" };
        let deep = open.repeat(100_000) + inner + &close.repeat(100_000);
        for (path, body) in [
            ("/v1/worlds/a/particles", deep.clone()),
            ("/v1/worlds/a/particles", format!("{{\"count\":1,\"position\":{deep}}}")),
            ("/v1/worlds/a/advance", format!("{{\"duration\":1,\"until\":{deep}}}")),
            ("/v1/worlds/a/commands", format!("{{\"commands\":[{{\"set\":{{\"mass\":{deep}}}}}]}}")),
        ] {
            client.post(path, &body).expect(422);
        }
    }
    client.post("/v1/worlds/a/particles", &"[".repeat(1_000_000)).expect(400);
}

/// The codes that need more than one request each have a test that names them here.
#[test]
fn every_code_is_seen() {
    let elsewhere = [
        "malformed_request",            // connections.rs
        "malformed_snapshot",           // snapshot.rs
        "unsupported_snapshot_version", // snapshot.rs
        "precision_mismatch",           // snapshot.rs
        "uri_too_long",                 // connections.rs
        "headers_too_large",            // connections.rs
        "unauthorized",                 // access.rs
        "read_only_token",              // access.rs
        "body_timeout",                 // connections.rs
        "body_too_large",               // above
        "shutting_down",                // command_line.rs
        "internal_error",               // src/server/mod.rs
        "world_quarantined",            // src/server/slot.rs
        "limit_reached",                // above
        "answer_too_large",             // above
        "overloaded",                   // overload.rs
        "idempotency_key_in_flight",    // retries.rs
        "idempotency_key_reused",       // retries.rs
        "invalid_idempotency_key",      // retries.rs
    ];
    let seen: HashSet<&str> =
        ROWS.iter().map(|row| row.4).chain(HEADERS.iter().map(|row| row.3)).chain(elsewhere).collect();
    let service = Service::start();
    let mut client = service.client();
    let description = client.get("/openapi.json").expect(200).json();
    let all: HashSet<String> = description["components"]["schemas"]["ProblemCode"]["enum"]
        .as_array()
        .expect("the list of codes")
        .iter()
        .map(|code| code.as_str().expect("a word").to_owned())
        .collect();
    let seen: HashSet<String> = seen.into_iter().map(str::to_owned).collect();
    assert_eq!(seen, all);
    for code in all {
        assert!(client.get(&format!("/problems/{code}")).expect(200).text().len() > 40, "{code} is explained");
    }
}

/// When several things are wrong, the first of the contract's order answers.
#[test]
fn the_first_thing_wrong_answers() {
    let service = Service::with(|config| config.body_bytes_max = 64);
    let mut client = service.client();
    client.put("/v1/worlds/a", "").expect(201);
    client.post("/v1/worlds/a/particles", "{}").expect(201);
    let wrong = [("origin", "http://evil.example"), ("content-type", "image/png"), ("if-match", "\"9\"")];
    let path = "/v1/worlds/a/particles/0/mass?x=1";
    let mut code = |path: &str, headers: &[(&str, &str)], body: &str| {
        client.send("PUT", path, headers, Some(body.as_bytes())).json()["code"].as_str().expect("a code").to_owned()
    };
    assert_eq!(code("/nowhere", &wrong, "{"), "cross_origin");
    assert_eq!(code("/nowhere", &wrong[1..], "{"), "unknown_route");
    assert_eq!(code("/v1/worlds/a/advance", &wrong[1..], "{"), "method_not_allowed");
    assert_eq!(code("/v1/worlds/b/particles/9/mass?x=1", &wrong[1..], "{"), "unsupported_media_type");
    assert_eq!(code("/v1/worlds/b/particles/9/mass?x=1", &wrong[2..], "{"), "unknown_world");
    assert_eq!(code("/v1/worlds/a/particles/9/mass?x=1", &wrong[2..], "{"), "unknown_particle");
    assert_eq!(code(path, &wrong[2..], "{"), "malformed_json");
    assert_eq!(code(path, &wrong[2..], "{\"mass\":\"x\"}"), "revision_mismatch");
    assert_eq!(code(path, &[], "{\"mass\":\"x\"}"), "invalid_field");
}
