//! Bytes to a world, in half of the runs with the checksum that they should have. What is restored is a world like any other:
//! whatever is done to it, it can be written down and read back, and no number in it is other than finite.

#![no_main]

use libfuzzer_sys::{Corpus, fuzz_target};
use pointmass::{
    Advance, Column, Command, Configure, Integrator, Limits, NewParticles, Particle, ParticleId, Precision, Properties,
    Real, Selection, Snapshot, World,
};

const LIMITS: Limits = Limits { particles: 100, steps: 1000, particle_steps: 10_000, interactions: 100_000 };

fn snapshot<R: Real>(world: &World<R>) -> Vec<u8> {
    let mut bytes = Vec::new();
    world.snapshot(&mut bytes).expect("a vector takes all");
    bytes
}

fn read<R: Real>(world: &World<R>) {
    world.for_each_block(|block| {
        let mut numbers = block.position.iter().chain(&block.velocity).flatten();
        assert!(numbers.all(|x| x.is_finite()), "{block:?}");
    });
    for particle in world.particles() {
        assert_eq!(world.particle(particle.id), Ok(particle));
    }
}

/// A bit of everything.
fn use_it<R: Real>(world: &mut World<R>) {
    let first = world.particles().next().map_or(ParticleId(0), |particle| particle.id);
    let force = Column::Uniform([R::ONE, R::ZERO, R::HALF].into());
    let damping = Some(Column::Uniform(R::HALF));
    for command in [
        Command::Advance(Advance::by(0.5)),
        Command::Create(NewParticles { count: 2, ..Particle::default().into() }),
        Command::AddForce { ids: first.into(), force: force.clone() },
        Command::Impulse { ids: Selection::All, impulse: force.clone() },
        Command::Advance(Advance { report_error: true, max_step: Some(0.1), ..Advance::by(0.5) }),
        Command::Remove { ids: first.into() },
        Command::AddForce { ids: Selection::All, force },
        Command::Configure(Configure { integrator: Some(Integrator::Exact), ..Configure::default() }),
        Command::Set { ids: Selection::All, properties: Properties { damping, ..Properties::default() } },
        Command::Advance(Advance::by(3.0)),
        Command::Configure(Configure { integrator: Some(Integrator::Rk4), ..Configure::default() }),
        Command::Advance(Advance::by(0.25)),
    ] {
        let _may_be_refused = world.apply(&command);
        read(world);
    }
}

fn run<R: Real>(bytes: &[u8]) {
    let Ok(mut world) = World::<R>::restore(bytes, LIMITS) else { return };
    read(&world);
    let written = snapshot(&world);
    let mut again = World::<R>::restore(written.as_slice(), LIMITS).expect("it was just written");
    assert_eq!(snapshot(&again), written);
    use_it(&mut world);
    use_it(&mut again);
    assert_eq!(again.digest(), world.digest());
}

fuzz_target!(|input: &[u8]| -> Corpus {
    let Some((is_signed, bytes)) = input.split_first() else { return Corpus::Reject };
    let mut bytes = bytes.to_vec();
    if is_signed % 2 == 1
        && let Some(end) = bytes.len().checked_sub(4)
    {
        let sum = crc32fast::hash(&bytes[..end]);
        bytes[end..].copy_from_slice(&sum.to_le_bytes());
    }
    match Snapshot::open(bytes.as_slice()).map(|snapshot| snapshot.precision()) {
        Ok(Precision::Single) => run::<f32>(&bytes),
        Ok(Precision::Double) => run::<f64>(&bytes),
        Err(_) => return Corpus::Reject,
    }
    Corpus::Keep
});
