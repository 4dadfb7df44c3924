//! Every instruction set of the machine against plain numbers, bit for bit.

use std::sync::atomic::AtomicBool;

use super::gravitation::{BLOCK, pull};
use super::{Laws, Masses, State, System, Turn};
use crate::integrator::Integrator;
use crate::kernel::tests::levels;
use crate::real::Real;
use crate::threads::Threads;

static NEVER: AtomicBool = AtomicBool::new(false);

/// Numbers between -1 and 1 (xorshift).
struct Random(u64);

impl Random {
    fn unit(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        f64::from(u32::try_from(self.0 >> 32).expect("32 bits")) / f64::from(1u32 << 31) - 1.0
    }

    fn vector<R: Real>(&mut self, scale: f64) -> [R; 3] {
        std::array::from_fn(|_| R::nearest(scale * self.unit()))
    }
}

/// Some particles with every kind of law; some of them at the same place, some near each other.
fn scene<R: Real>(count: usize, softening: f64) -> (Laws<R>, Vec<[R; 3]>, Vec<[R; 3]>) {
    let random = &mut Random(88_172_645_463_325_252);
    let mut places: Vec<[R; 3]> = (0..count).map(|_| random.vector(3.0)).collect();
    for i in (7..count).step_by(11) {
        places[i] = places[i - 7];
    }
    for i in (9..count).step_by(13) {
        let tiny: f64 = if R::ROUND_OFF > 1e-10 { 1e-18 } else { 1e-145 };
        places[i] = random.vector(tiny);
    }
    let speeds = (0..count).map(|_| random.vector(2.0)).collect();
    let each = |f: &dyn Fn(usize) -> f64| (0..count).map(|i| R::nearest(f(i))).collect::<Vec<R>>();
    let laws = Laws {
        acceleration: (0..count).map(|_| random.vector(9.0)).collect(),
        driving: (0..count).map(|_| random.vector(9.0)).collect(),
        damping: each(&|i| [1.0, 0.9, 0.5][i % 3]),
        factor: each(&|i| [1.0, 0.99, 0.9][i % 3]),
        drag: (0..count).map(|i| [R::nearest([0.0, 0.1][i % 2]), R::nearest([0.0, 0.3, 0.0, 0.2][i % 4])]).collect(),
        gravitation: Some(Masses {
            softening: R::nearest(softening),
            strength: each(&|i| if i % 5 == 4 { 0.0 } else { 1e-40 * f64::from(u32::try_from(i).expect("few")) }),
            immovable: (0..count).filter(|i| i % 17 == 3).collect(),
        }),
    };
    (laws, places, speeds)
}

fn bits<R: Real>(columns: &[R]) -> Vec<u64> {
    columns.iter().map(|x| -> f64 { (*x).into() }).map(f64::to_bits).collect()
}

/// The attraction of all particles by all, one after the other.
fn plain<R: Real>(masses: &Masses<R>, places: &[[R; 3]]) -> Vec<[R; 3]> {
    let soft = masses.softening * masses.softening;
    let far = places.iter().flatten().any(|x| x.abs() >= R::FAR);
    let sources: Vec<usize> = (0..places.len()).filter(|&i| masses.strength[i] > R::ZERO).collect();
    let on = |target: usize| {
        if masses.immovable.contains(&target) {
            return [R::ZERO; 3];
        }
        let (mut total, mut lost) = ([R::ZERO; 3], [R::ZERO; 3]);
        for block in sources.chunks(BLOCK) {
            let mut sum = [R::ZERO; 3];
            for &source in block {
                let d: [R; 3] = std::array::from_fn(|k| places[source][k] - places[target][k]);
                let square = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]) + soft;
                let is_ordinary = square >= R::NEAR && !far;
                let inverse = R::ONE / square.square_root();
                let magnitude = masses.strength[source] * (inverse * inverse);
                let alone = pull(places[source], masses.strength[source], places[target], masses.softening);
                for k in 0..3 {
                    sum[k] = sum[k] + if is_ordinary { magnitude * (d[k] * inverse) } else { alone[k] };
                }
            }
            for k in 0..3 {
                let new = total[k] + sum[k];
                let rounded = new - total[k];
                lost[k] = lost[k] + ((total[k] - (new - rounded)) + (sum[k] - rounded));
                total[k] = new;
            }
        }
        std::array::from_fn(|k| total[k] + lost[k])
    };
    (0..places.len()).map(on).collect()
}

fn check_attraction<R: Real>(count: usize, softening: f64, far: bool) {
    let (laws, mut places, _) = scene::<R>(count, softening);
    if far && count > 5 {
        // The square of their distance is not a number of the precision.
        places[5] = [R::nearest(0.4 * R::LARGEST), R::ZERO, R::nearest(-0.3 * R::LARGEST)];
    }
    let masses = laws.gravitation.as_ref().expect("the scene has it");
    let expected = plain(masses, &places);
    for level in levels() {
        let mut attraction = super::Attraction::new(masses);
        let p = super::to_columns(&places);
        let mut seen = vec![R::ZERO; p.len()];
        attraction.evaluate(level, &Threads::default(), &NEVER, &p, &mut seen);
        let mut rows = vec![[R::ZERO; 3]; count];
        super::to_rows(&seen, &mut rows);
        assert_eq!(
            bits(rows.as_flattened()),
            bits(expected.as_flattened()),
            "{count} of {}, softening {softening}, {level:?}",
            R::PRECISION
        );
    }
}

#[test]
fn attraction_is_the_same_on_every_instruction_set() {
    for softening in [0.0, 1e-25, 0.1] {
        for count in (0..40).chain([300, 1030]) {
            for far in [false, true] {
                check_attraction::<f32>(count, softening, far);
                check_attraction::<f64>(count, softening, far);
            }
        }
    }
}

fn check_steps<R: Real>(integrator: Integrator, count: usize, compensated: bool) {
    let (laws, places, speeds) = scene::<R>(count, 0.1);
    let nothing = vec![[R::ZERO; 3]; if compensated { count } else { 0 }];
    let threads = Threads::default();
    let ends = levels().into_iter().map(|level| {
        let mut system = System::new(level, &threads, &NEVER, integrator, &laws);
        let mut state = State::new(&places, &speeds, &nothing, &nothing);
        (1..=5).for_each(|step| system.step(0.01, Turn { step, last: step == 5 }, &mut state));
        let (mut p, mut v) = (places.clone(), speeds.clone());
        let (mut lost_p, mut lost_v) = (nothing.clone(), nothing.clone());
        state.store(&mut p, &mut v, &mut lost_p, &mut lost_v);
        assert_eq!(compensated, lost_p.iter().any(|lost| *lost != [R::ZERO; 3]), "{integrator}");
        [p, v, lost_p, lost_v].map(|rows| bits(rows.as_flattened()))
    });
    let ends: Vec<_> = ends.collect();
    assert!(ends.iter().all(|end| *end == ends[0]), "{count} under {integrator}, {}", R::PRECISION);
}

#[test]
fn steps_are_the_same_on_every_instruction_set() {
    for integrator in Integrator::ALL.into_iter().filter(|integrator| integrator.serves_forces()) {
        for count in [1, 2, 7, 8, 9, 33] {
            check_steps::<f32>(integrator, count, false);
            check_steps::<f64>(integrator, count, false);
            if !integrator.is_euler() {
                check_steps::<f32>(integrator, count, true);
                check_steps::<f64>(integrator, count, true);
            }
        }
    }
}
