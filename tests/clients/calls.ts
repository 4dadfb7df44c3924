// Calls of every kind through types that were generated: tsc checks the shapes, this program the values.
// The argument is the address of a service without a world.

import createClient from "openapi-fetch";
import type { components, paths } from "./pointmass.js";

type Shapes = components["schemas"];
declare const process: { argv: string[] };

const client = createClient<paths>({ baseUrl: process.argv[2] ?? "" });
let calls = 0;

/** What an accepted request was answered with. */
async function accepted<T>(answer: Promise<{ data?: T; error?: unknown; response: Response }>): Promise<T> {
    calls += 1;
    const { data, error, response } = await answer;
    if (data === undefined) throw new Error(`${response.status} ${response.url}: ${JSON.stringify(error)}`);
    return data;
}

/** What a refused one was refused with. */
async function refused<T>(answer: Promise<{ data?: unknown; error?: T; response: Response }>): Promise<T> {
    calls += 1;
    const { data, error, response } = await answer;
    if (error === undefined) throw new Error(`${response.status} ${response.url}: ${JSON.stringify(data)}`);
    return error;
}

function equal<T>(value: T, expected: T): void {
    const [a, b] = [JSON.stringify(value), JSON.stringify(expected)];
    if (a !== b) throw new Error(`${a} is not ${b}`);
}

/** Of several shapes the one that has this member; the compiler knows no other that has it. */
function having<T extends object, K extends PropertyKey>(value: T, key: K): Extract<T, Record<K, unknown>> {
    if (!(key in value)) throw new Error(`${JSON.stringify(value)} has no ${String(key)}`);
    return value as Extract<T, Record<K, unknown>>;
}

const world = (name: string) => ({ params: { path: { world: name } } });
const particle = (id: number) => ({ params: { path: { world: "a", id } } });

const service: Shapes["Service"] = await accepted(client.GET("/v1"));
equal(service.name, "pointmass");
equal(service.limits.duration_max, null);

const created: Shapes["World"] = await accepted(client.PUT("/v1/worlds/{world}", { ...world("a"), body: { gravity: "textbook" } }));
equal(created.gravity, [0, -10, 0]);
equal(created.max_step, null);
const still = await accepted(
    client.PUT("/v1/worlds/{world}", { ...world("still"), body: { integrator: "rk4", forces: { drag: { k2: 0.5 } } } }),
);
equal(still.forces?.drag?.k2, 0.5);
const without = await accepted(client.PATCH("/v1/worlds/{world}", { ...world("still"), body: { forces: null } }));
equal(without.forces, undefined);
equal((await accepted(client.GET("/v1/worlds"))).worlds.map((each) => each.world), ["a", "still"]);
const exists = await refused(client.PUT("/v1/worlds/{world}", { ...world("a"), body: {} }));
equal([exists.code, exists.status], ["world_exists", 409]);

const particles = "/v1/worlds/{world}/particles";
const one = await accepted(client.POST(particles, { ...world("a"), body: { position: [0, 20, 0], mass: 2 } }));
equal(having(one, "id").inverse_mass, 0.5);
const two = await accepted(client.POST(particles, { ...world("a"), body: [{}, { inverse_mass: 0 }] }));
equal(having(two, "first_id").count, 2);
const columns = { count: 2, position: [[0, 1, 0], [5, 1, 0]], velocity: [1, 0, 0], damping: 0.5 } satisfies Shapes["NewParticleColumns"];
equal(having(await accepted(client.POST(particles, { ...world("a"), body: columns })), "first_id").first_id, 3);
equal((await accepted(client.GET(`${particles}/{id}`, particle(2)))).mass, null);
const own = await accepted(client.PATCH(`${particles}/{id}`, { ...particle(1), body: { acceleration: [0, 0, 0] } }));
equal(own.own_acceleration, [0, 0, 0]);
equal((await accepted(client.PUT(`${particles}/{id}/mass`, { ...particle(0), body: { inverse_mass: 0.25 } }))).mass, 4);
equal((await refused(client.PUT(`${particles}/{id}/mass`, { ...particle(0), body: { mass: 0 } }))).pointer, "/mass");
await accepted(client.POST(`${particles}/{id}/force`, { ...particle(0), body: { force: [0, 40, 0] } }));
equal((await accepted(client.POST("/v1/worlds/{world}/forces", { ...world("a"), body: { ids: [1], force: [1, 0, 0] } }))).count, 1);
await accepted(client.POST(`${particles}/{id}/impulse`, { ...particle(0), body: { impulse: [4, 0, 0] } }));

const advance = "/v1/worlds/{world}/advance";
const done = await accepted(client.POST(advance, { ...world("a"), body: { duration: 0.5, return: ["position"] } }));
equal(done.state?.position?.[0], [0.5, 20, 0]);
const until = { particle: 0, plane: { normal: [0, 1, 0] } };
const landed = await accepted(client.POST(advance, { ...world("a"), body: { duration: 60, until } }));
equal([landed.crossed, landed.duration], [true, 2]);
const state = await accepted(
    client.GET("/v1/worlds/{world}/state", { params: { path: { world: "a" }, query: { fields: "mass", ids: "0,2" } } }),
);
equal([state.id, state.mass], [[0, 2], [4, null]]);
const page = await accepted(client.GET(particles, { params: { path: { world: "a" }, query: { limit: 2 } } }));
equal(page.next_after, 1);

const commands: Shapes["Command"][] = [
    { create: { position: [0, 1, 0] } },
    { set: { ids: [5], mass: 2 } },
    { add_force: { ids: [5], force: [2, 0, 0] } },
    { advance: { duration: 1 } },
    { read: { fields: ["position"], ids: [5] } },
    { remove: { ids: [5] } },
];
const batch = await accepted(client.POST("/v1/worlds/{world}/commands", { ...world("a"), body: { commands } }));
equal(batch.results.map((result) => ("first_id" in result ? "created" : "step" in result ? "advanced" : "id" in result ? "read" : "counted")),
    ["created", "counted", "counted", "advanced", "read", "counted"]);
const read = batch.results[4];
equal(read && having(read, "id").position?.[0]?.length, 3);
const both = await accepted(
    client.POST("/v1/commands", { body: { worlds: { a: { commands: [{ remove: { ids: [5] } }] }, still: { commands: [{ read: {} }] } } } }),
);
equal(Object.values(both.worlds).map((each) => ("code" in each ? each.code : each.revision)), ["unknown_particle", 1]);

const path = "/v1/worlds/{world}/snapshot";
const snapshot: ArrayBuffer = await accepted(client.GET(path, { ...world("a"), parseAs: "arrayBuffer" }));
// Bytes are a string in a type, as JSON has no other place for them.
const bytes = { body: snapshot as unknown as string, bodySerializer: (body: unknown) => body as ArrayBuffer };
const headers = { "content-type": "application/octet-stream" };
const clone: Shapes["World"] = await accepted(client.PUT(path, { ...world("clone"), ...bytes, headers }));
equal([clone.world, clone.particle_count], ["clone", 5]);
const digests = ["a", "clone"].map((name) => accepted(client.GET("/v1/worlds/{world}/digest", world(name))));
const [first, second] = await Promise.all(digests);
equal(first?.digest, second?.digest);

for (const name of ["a", "still", "clone"]) {
    calls += 1;
    equal((await client.DELETE("/v1/worlds/{world}", world(name))).response.status, 204);
}
console.log(`TypeScript: ${calls} calls`);
