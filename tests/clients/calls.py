"""Calls of every kind by the generated client: each answer is of one type, with the values that were asked for.

The argument is the address of a service without a world.
"""

import io
import sys
from http import HTTPStatus

from pointmass_client import Client, models as m
from pointmass_client.api.advance import advance, read_trajectory
from pointmass_client.api.commands import run_commands, run_commands_in_worlds
from pointmass_client.api.forces import add_force, add_forces, apply_impulse
from pointmass_client.api.particles import (
    create_particles,
    list_particles,
    place_particle,
    read_particle,
    read_state,
    remove_particle,
    set_mass,
    set_particle,
    set_particles,
)
from pointmass_client.api.service import describe_service, read_metrics
from pointmass_client.api.worlds import (
    configure_world,
    create_world,
    delete_world,
    describe_world,
    digest_world,
    list_worlds,
    restore_world,
    snapshot_world,
)
from pointmass_client.types import UNSET, File

client = Client(base_url=sys.argv[1], raise_on_unexpected_status=True)
calls = 0


def call(kind, route, *args, **kwargs):
    """Makes a call whose answer has to be of this type."""
    global calls
    calls += 1
    answer = route.sync(*args, client=client, **kwargs)
    assert type(answer) is kind, f"{route.__name__}: {type(answer)} is not {kind}: {answer}"
    return answer


def equal(value, expected):
    assert value == expected and type(value) is type(expected), f"{value!r} is not {expected!r}"


service = call(m.Service, describe_service)
equal(service.name, "pointmass")
assert service.limits.duration_max is None
assert "pointmass_worlds 0" in call(str, read_metrics)

# Worlds: their settings have defaults, alternatives and null.
world = call(m.World, create_world, "a", body=m.NewWorld(gravity=m.NewWorldGravityType1.TEXTBOOK))
equal(world.gravity, [0.0, -10.0, 0.0])
assert world.max_step is None and world.forces is UNSET
equal(call(m.Worlds, list_worlds).worlds[0].world, "a")
drag = m.WorldForces(drag=m.Drag(k2=0.5))
still = call(m.World, create_world, "still", body=m.NewWorld(integrator=m.NewWorldIntegrator.RK4, max_step=0.25, forces=drag))
equal(still.forces.drag.k2, 0.5)
assert still.forces.gravitation is None
without = call(m.World, configure_world, "still", body=m.ConfigureWorld(max_step=None, forces=None))
assert without.max_step is None and without.forces is UNSET
refused = call(m.Problem, create_world, "a", body=m.NewWorld())
equal((refused.code, refused.status), (m.ProblemCode.WORLD_EXISTS, 409))

# Particles: one, a list, and columns.
one = call(m.Particle, create_particles, "a", body=m.NewParticle(position=[0.0, 20.0, 0.0], mass=2.0))
equal((one.id, one.inverse_mass), (0, 0.5))
assert one.own_acceleration is None and one.drag is UNSET
two = call(m.Created, create_particles, "a", body=[m.NewParticle(), m.NewParticle(inverse_mass=0.0)])
equal((two.first_id, two.count), (1, 2))
columns = m.NewParticleColumns(count=2, position=[[0.0, 1.0, 0.0], [5.0, 1.0, 0.0]], velocity=[1.0, 0.0, 0.0], damping=0.5)
equal(call(m.Created, create_particles, "a", body=columns).first_id, 3)
equal(call(m.Particle, read_particle, "a", 4).position, [5.0, 1.0, 0.0])
assert call(m.Particle, read_particle, "a", 2).mass is None
own = call(m.Particle, set_particle, "a", 1, body=m.SetParticle(acceleration=[0.0, 0.0, 0.0], damping=0.75))
equal((own.own_acceleration, own.damping), ([0.0, 0.0, 0.0], 0.75))
assert call(m.Particle, set_particle, "a", 1, body=m.SetParticle(acceleration=None)).own_acceleration is None
equal(call(m.Particle, set_mass, "a", 0, body=m.Mass(inverse_mass=0.25)).mass, 4.0)
equal(call(m.Problem, set_mass, "a", 0, body=m.Mass(mass=0.0)).pointer, "/mass")
equal(call(m.Changed, set_particles, "a", body=m.SetParticles(damping=[1.0, 1.0, 1.0, 0.5, 0.5])).count, 5)
equal(call(m.Particle, place_particle, "a", 1, body=m.Place(velocity=[0.0, 1.0, 0.0])).velocity, [0.0, 1.0, 0.0])
equal(call(m.Particle, add_force, "a", 0, body=m.Force(force=[0.0, 40.0, 0.0])).force, [0.0, 40.0, 0.0])
equal(call(m.Changed, add_forces, "a", body=m.Forces(ids=[1, 3], force=[[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])).count, 2)
equal(call(m.Particle, apply_impulse, "a", 0, body=m.Impulse(impulse=[4.0, 0.0, 0.0])).velocity, [1.0, 0.0, 0.0])

# Time.
done = call(m.Advanced, advance, "a", body=m.Advance(duration=0.5, return_=[m.AdvanceReturnItem.POSITION]))
equal((done.time, done.state.id, done.state.position[0]), (0.5, [0, 1, 2, 3, 4], [0.5, 20.0, 0.0]))
assert done.crossed is UNSET and done.error is UNSET and done.state.velocity is UNSET
floor = m.Until(particle=0, plane=m.Plane(normal=[0.0, 1.0, 0.0]))
landed = call(m.Advanced, advance, "a", body=m.Advance(duration=60.0, until=floor, report_error=True))
equal((landed.crossed, landed.duration, landed.time), (True, 2.0, 2.5))
way = call(m.Trajectory, read_trajectory, "a", 0, duration=1.0, samples=3)
equal(way.time, [2.5, 3.0, 3.5])
state = call(m.State, read_state, "a", fields="mass,own_acceleration", ids="0,2")
equal((state.id, state.mass, state.own_acceleration), ([0, 2], [4.0, None], [None, None]))
page = call(m.Particles, list_particles, "a", limit=2)
equal(([particle.id for particle in page.particles], page.next_after), ([0, 1], 1))

# Batches: each result is of the type that its command has.
commands = m.Commands(
    commands=[
        m.Command(create=m.NewParticle(position=[0.0, 1.0, 0.0])),
        m.Command(create=[m.NewParticle()]),
        m.Command(place=m.Places(ids=[5], position=[7.0, 7.0, 7.0])),
        m.Command(set_=m.SetParticles(ids=[5], mass=2.0)),
        m.Command(add_force=m.Forces(ids=[5], force=[2.0, 0.0, 0.0])),
        m.Command(impulse=m.Impulses(ids=[5], impulse=[2.0, 0.0, 0.0])),
        m.Command(advance=m.Advance(duration=1.0)),
        m.Command(read=m.ReadColumns(fields=[m.ReadColumnsFieldsItem.POSITION], ids=[5])),
        m.Command(remove=m.Removal(ids=[5, 6])),
    ]
)
batch = call(m.CommandResults, run_commands, "a", body=commands)
kinds = [m.Created, m.Created, m.Counted, m.Counted, m.Counted, m.Counted, m.Advanced, m.State, m.Counted]
equal([type(result) for result in batch.results], kinds)
equal(batch.results[7].position, [[8.5, 2.0, 7.0]])
unknown = m.Commands(commands=[m.Command(remove=m.Removal(ids=[5]))])
equal(call(m.Problem, run_commands, "a", body=unknown).pointer, "/commands/0/remove/ids/0")
worlds = m.CommandsOfWorldsWorlds.from_dict({"a": unknown.to_dict(), "still": {"commands": [{"read": {}}]}})
both = call(m.ResultsOfWorlds, run_commands_in_worlds, body=m.CommandsOfWorlds(worlds=worlds)).worlds
equal([type(both["a"]), type(both["still"])], [m.Problem, m.CommandResults])
equal(type(both["still"].results[0]), m.State)

# Snapshots are bytes.
snapshot = call(File, snapshot_world, "a").payload.read()
assert isinstance(snapshot, bytes) and len(snapshot) > 100
clone = call(m.World, restore_world, "clone", body=File(payload=io.BytesIO(snapshot)))
equal((clone.world, clone.particle_count), ("clone", 5))
equal(call(m.Digest, digest_world, "clone").digest, call(m.Digest, digest_world, "a").digest)
equal(call(m.Problem, restore_world, "clone", body=File(payload=io.BytesIO(b"nothing"))).code, m.ProblemCode.MALFORMED_SNAPSHOT)

# Answers without a body.
for gone in (remove_particle.sync_detailed("a", 0, client=client), delete_world.sync_detailed("clone", client=client)):
    calls += 1
    equal(gone.status_code, HTTPStatus.NO_CONTENT)
equal(call(m.Problem, describe_world, "clone").code, m.ProblemCode.UNKNOWN_WORLD)
for name in ("a", "still"):
    delete_world.sync_detailed(name, client=client)
print(f"Python: {calls} calls")
