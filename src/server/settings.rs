//! Settings of a world that are objects in a body: what is absent in one stays as it is, at creation as by default.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::command::{Settings, Tolerance};
use crate::forces::{Drag, Forces, Gravitation};
use crate::server::body::Raw;
use crate::server::json::{Object, WireReal, present};
use crate::server::problem::Problem;

/// The forces that depend on where a particle is and how fast it moves; null switches one off.
#[derive(Debug, Clone, Deserialize, Serialize, ToSchema)]
#[serde(deny_unknown_fields, bound = "")]
#[schema(as = WorldForces, bound = "", example = json!({
    "drag": {"k1": 0.1, "k2": 0.02}, "gravitation": {"constant": 6.6743e-11, "softening": 0.0}
}))]
pub(crate) struct ForcesBody<R: WireReal> {
    /// Slows every movable particle down. Default null: no particle has drag.
    #[serde(default, deserialize_with = "present", skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<DragBody<f64>>)]
    #[expect(clippy::option_option, reason = "absent, null and an object are three things")]
    drag: Option<Option<Object<DragBody<R>>>>,
    /// Every particle attracts every movable one. Default null: none does.
    #[serde(default, deserialize_with = "present", skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<GravitationBody<f64>>)]
    #[expect(clippy::option_option, reason = "absent, null and an object are three things")]
    gravitation: Option<Option<Object<GravitationBody<R>>>>,
}

/// A force of k1 |v| + k2 |v|² newtons against the velocity v.
#[derive(Debug, Clone, Deserialize, Serialize, ToSchema)]
#[serde(deny_unknown_fields, bound = "")]
#[schema(as = Drag, bound = "", example = json!({"k1": 0.1, "k2": 0.02}))]
pub(crate) struct DragBody<R: WireReal> {
    /// In kg/s, at least 0; default 0.
    #[serde(default, deserialize_with = "present")]
    #[schema(value_type = Option<f64>, nullable = false, minimum = 0)]
    k1: Option<R>,
    /// In kg/m, at least 0; default 0.
    #[serde(default, deserialize_with = "present")]
    #[schema(value_type = Option<f64>, nullable = false, minimum = 0)]
    k2: Option<R>,
}

/// A force of G m₁ m₂ r / (r² + ε²)^(3/2) newtons between two particles at a distance r.
#[derive(Debug, Clone, Deserialize, Serialize, ToSchema)]
#[serde(deny_unknown_fields, bound = "")]
#[schema(as = Gravitation, bound = "", example = json!({"constant": 6.6743e-11, "softening": 0.0}))]
pub(crate) struct GravitationBody<R: WireReal> {
    /// G in m³/(kg s²), at least 0; default 6.6743e-11.
    #[serde(default, deserialize_with = "present")]
    #[schema(value_type = Option<f64>, nullable = false, minimum = 0)]
    constant: Option<R>,
    /// ε in metres, at least 0; default 0.
    #[serde(default, deserialize_with = "present")]
    #[schema(value_type = Option<f64>, nullable = false, minimum = 0)]
    softening: Option<R>,
}

/// The error that `dop853` may make in one step: absolute + relative x the distance from the origin, and the same for
/// the velocity. Not both 0.
#[derive(Debug, Clone, Copy, Default, Deserialize, Serialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = Tolerance, example = json!({"absolute": 1e-12, "relative": 1e-12}))]
pub(crate) struct ToleranceBody {
    /// In metres, and in m/s; at least 0; default 1e-9.
    #[serde(default, deserialize_with = "present")]
    #[schema(nullable = false, minimum = 0)]
    absolute: Option<f64>,
    /// At least 0; default 1e-9.
    #[serde(default, deserialize_with = "present")]
    #[schema(nullable = false, minimum = 0)]
    relative: Option<f64>,
}

/// What a request says of these settings.
#[derive(Debug)]
pub(crate) struct Parts<R: WireReal> {
    #[expect(clippy::option_option, reason = "absent, null and an object are three things")]
    forces: Option<Option<Object<ForcesBody<R>>>>,
    tolerance: ToleranceBody,
}

impl<R: WireReal> Parts<R> {
    /// Reads the forces in the precision of the world.
    pub(crate) fn read(forces: Option<Raw<'_>>, tolerance: Option<Object<ToleranceBody>>) -> Result<Self, Problem> {
        Ok(Self {
            forces: forces.map(|raw| raw.read("/forces")).transpose()?,
            tolerance: tolerance.map_or_else(ToleranceBody::default, |Object(tolerance)| tolerance),
        })
    }

    /// The way to a force that is asked for.
    pub(crate) fn pointer_to_force(&self) -> Option<&'static str> {
        let Some(Some(Object(ForcesBody { drag, gravitation }))) = &self.forces else { return None };
        match (drag, gravitation) {
            (Some(Some(_)), _) => Some("/forces/drag"),
            (_, Some(Some(_))) => Some("/forces/gravitation"),
            _ => None,
        }
    }

    /// The new values, where these are the old ones.
    pub(crate) fn over(self, old: &Settings<R>) -> (Forces<R>, Tolerance) {
        let forces = match self.forces {
            None => old.forces,
            Some(None) => Forces::default(),
            Some(Some(Object(forces))) => forces.over(&old.forces),
        };
        let ToleranceBody { absolute, relative } = self.tolerance;
        let tolerance = Tolerance {
            absolute: absolute.unwrap_or(old.tolerance.absolute),
            relative: relative.unwrap_or(old.tolerance.relative),
        };
        (forces, tolerance)
    }
}

impl<R: WireReal> ForcesBody<R> {
    fn over(self, old: &Forces<R>) -> Forces<R> {
        let drag = |Object(DragBody { k1, k2 })| {
            let old = old.drag.unwrap_or_default();
            Drag { k1: k1.unwrap_or(old.k1), k2: k2.unwrap_or(old.k2) }
        };
        let gravitation = |Object(GravitationBody { constant, softening })| {
            let old = old.gravitation.unwrap_or_default();
            Gravitation { constant: constant.unwrap_or(old.constant), softening: softening.unwrap_or(old.softening) }
        };
        Forces {
            drag: self.drag.map_or(old.drag, |new| new.map(drag)),
            gravitation: self.gravitation.map_or(old.gravitation, |new| new.map(gravitation)),
        }
    }

    /// Both, where there is one.
    pub(crate) fn of(forces: &Forces<R>) -> Option<Self> {
        let drag = |Drag { k1, k2 }| Object(DragBody { k1: Some(k1), k2: Some(k2) });
        let gravitation = |Gravitation { constant, softening }| {
            Object(GravitationBody { constant: Some(constant), softening: Some(softening) })
        };
        forces
            .any()
            .then(|| Self { drag: Some(forces.drag.map(drag)), gravitation: Some(forces.gravitation.map(gravitation)) })
    }
}

impl ToleranceBody {
    /// Where it is not the default.
    pub(crate) fn of(tolerance: Tolerance) -> Option<Self> {
        let Tolerance { absolute, relative } = tolerance;
        (tolerance != Tolerance::default()).then_some(Self { absolute: Some(absolute), relative: Some(relative) })
    }
}
