//! Which integrator with which setting.

use std::fmt::{self, Display};

use pointmass::{Integrator, Real, Settings, Tolerance};

use crate::measure::whole;

/// An integrator, with plain or compensated sums.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Method {
    pub(crate) integrator: Integrator,
    pub(crate) compensated: bool,
}

/// What decides how much work a method does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Setting {
    /// The closed form: how many advances make up the whole.
    Advances(u64),
    /// Steps of one advance.
    Steps(u64),
    /// The relative tolerance of each step; the absolute one is 0.
    Tolerance(f64),
}

impl Setting {
    /// How many steps, where they are fixed.
    pub(crate) fn steps(self) -> Option<f64> {
        match self {
            Self::Steps(steps) => Some(whole(steps)),
            Self::Advances(_) | Self::Tolerance(_) => None,
        }
    }
}

impl Method {
    /// In the order of tables.
    pub(crate) const ALL: [Self; 10] = [
        Self::plain(Integrator::NewtonEuler),
        Self::plain(Integrator::NewtonEulerQuadratic),
        Self::plain(Integrator::SemiImplicitEuler),
        Self::plain(Integrator::VelocityVerlet),
        Self::compensated(Integrator::VelocityVerlet),
        Self::plain(Integrator::Rk4),
        Self::compensated(Integrator::Rk4),
        Self::plain(Integrator::Dop853),
        Self::compensated(Integrator::Dop853),
        Self::plain(Integrator::Exact),
    ];

    pub(crate) const fn plain(integrator: Integrator) -> Self {
        Self { integrator, compensated: false }
    }

    pub(crate) const fn compensated(integrator: Integrator) -> Self {
        Self { integrator, compensated: true }
    }

    pub(crate) fn settings<R: Real>(self, setting: Setting) -> Settings<R> {
        let tolerance = match setting {
            Setting::Tolerance(relative) => Tolerance { absolute: 0.0, relative },
            Setting::Advances(_) | Setting::Steps(_) => Tolerance::default(),
        };
        Settings { integrator: self.integrator, compensated: self.compensated, tolerance, ..Settings::default() }
    }
}

impl Display for Method {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", self.integrator, if self.compensated { ", compensated" } else { "" })
    }
}
