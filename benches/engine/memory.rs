//! Memory of a world: what the resident set grows by in a process that does nothing else, because memory that was given
//! back in this one would be used again unseen.

use pointmass::{Command, NewParticles, Particle, ParticleId, Precision, World};

use crate::compare::{Case, Cell, Column, Group};
use crate::machine::Number;
use crate::scene::Random;

pub(crate) const MEMORY: Group = Group {
    name: "memory",
    title: "Memory: bytes of one particle",
    note: "Uniform. By how much the resident set of a fresh process grows, divided by the particles that are there: \
           created in one command, created one by one, and after a random half was removed. Position and velocity are \
           24 bytes in single and 48 in double.",
    size: "particles",
    columns: &[
        Column("in bulk", Cell::Bytes(BULK)),
        Column("one by one", Cell::Bytes(SINGLE)),
        Column("half removed", Cell::Bytes(HALF)),
    ],
    run: |bench| {
        let n = if bench.is_measuring() { 1_000_000 } else { 1000 };
        for precision in Precision::ALL {
            for way in [BULK, SINGLE, HALF] {
                if let Some(bytes) = measure_in_child(precision, way, n) {
                    bench.record(Case { precision, scene: "uniform".to_owned(), size: n }, way, vec![bytes]);
                }
            }
        }
    },
};

const BULK: &str = "created in bulk";
const SINGLE: &str = "created one by one";
const HALF: &str = "random half removed";

/// The first argument of the process that is measured; the second says what it does.
pub(crate) const CHILD: &str = "--memory";

/// Absent where no resident set is told.
fn measure_in_child(precision: Precision, way: &str, n: usize) -> Option<f64> {
    resident_set()?;
    let program = std::env::current_exe().expect("this program");
    let child = std::process::Command::new(program).args([CHILD, &format!("{precision}/{way}/{n}")]).output();
    let output = child.expect("this program can be started");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(String::from_utf8_lossy(&output.stdout).trim().parse().expect("it prints a number"))
}

/// What the child does: prints bytes per particle.
pub(crate) fn measure_here(what: &str) {
    let [precision, way, n] = what.split('/').collect::<Vec<_>>()[..] else { panic!("{what} has three parts") };
    let n = n.parse().expect("a number");
    let bytes = if precision == Precision::Single.name() { grown::<f32>(way, n) } else { grown::<f64>(way, n) };
    println!("{bytes}");
}

fn grown<R: Number>(way: &str, n: usize) -> f64 {
    let before = resident_set().expect("the parent looked");
    let mut world = World::<R>::default();
    let ones: R::Vec3 = [R::ONE; 3].into();
    let particle = Particle { position: ones, velocity: ones, ..Particle::default() };
    if way == SINGLE {
        for _ in 0..n {
            world.create(particle).expect("valid");
        }
    } else {
        world.apply(&Command::Create(NewParticles { count: n, ..particle.into() })).expect("valid");
    }
    if way == HALF {
        let mut order: Vec<ParticleId> = (0..n as u64).map(ParticleId).collect();
        Random(6).shuffle(&mut order);
        order.truncate(n / 2);
        for id in order {
            world.remove(id).expect("it exists");
        }
    }
    let after = resident_set().expect("the parent looked");
    (after - before) / world.particle_count() as f64
}

/// Bytes of this process that are in memory.
fn resident_set() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    Some(1024.0 * line.trim().strip_suffix("kB")?.trim().parse::<f64>().ok()?)
}
