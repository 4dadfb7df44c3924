"""Writes scenes.txt: where the motions of some scenes end, to 30 digits and more, computed by gmpy2 2.1 or later.

    pip install gmpy2 && python3 tests/reference/scenes.py > tests/reference/scenes.txt

Names of scenes as arguments restrict it to these. All take half an hour on two cores; `outer` needs g++ for scenes.cpp.

The motion is v' = a + ln(d) v - (k1 + k2 |v|) v + sum of G m (x - p)/|x - p|^3 over the others, p' = v. Every scene is
there twice: `double` has its numbers, `single` has the single nearest to each, and both solutions are those of exactly
the numbers given. Numbers of a single scene are written as the shortest decimal that reads back as that SINGLE. Times
are doubles in both.

    scene NAME double|single
    constant G
    acceleration x y z
    damping d
    drag k1 k2
    particle MASS GRAVITATIONAL_MASS px py pz vx vy vz
    at TIME
    end px py pz vx vy vz

Lines that would say 0 (damping: 1) are left out. A particle that pulls nothing has the masses 1 and 0, any other has
the same mass twice. After each `at` there is one `end` for each particle, in order; the last `at` is the duration. `#`
starts a comment.

Each scene is solved twice: in closed form and by Taylor series, or by Taylor series of two orders with two lengths of
step. A comment before each `at` says to how many digits both agree, and the first of both is written. The digits are
relative to the length of each position and velocity; the comment has the fewest.
"""

import os
import struct
import subprocess
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from fractions import Fraction
from operator import mul

import gmpy2
from gmpy2 import mpfr, mpq, sqrt

gmpy2.get_context().precision = 300


def exact(x):
    return mpfr(mpq(x))


def single(x):
    return struct.unpack("<f", struct.pack("<f", x))[0]


def shortest_single(x):
    return repr(next(y for y in (float(f"{x:.{n}g}") for n in range(1, 10)) if single(y) == x))


class Scene:
    def __init__(self, name, solve, times, particles, constant=0.0, acceleration=(0.0, 0.0, 0.0), damping=1.0, drag=(0.0, 0.0)):
        self.name, self.kind, self.solve, self.times = name, "double", solve, times
        # Mass, gravitational mass, position, velocity.
        self.particles = [[float(x) for x in p] for p in particles]
        self.constant, self.acceleration, self.damping, self.drag = constant, acceleration, damping, drag

    def single(self):
        particles = [[single(x) for x in p] for p in self.particles]
        vectors = [tuple(single(x) for x in v) for v in (self.acceleration, self.drag)]
        scene = Scene(self.name, self.solve, self.times, particles, single(self.constant), vectors[0], single(self.damping), vectors[1])
        scene.kind = "single"
        return scene

    def states(self):
        return [[exact(x) for x in p[2:]] for p in self.particles]

    def pulls(self):
        """G m of each particle, exact."""
        return [Fraction(self.constant) * Fraction(p[1]) for p in self.particles]

    def text(self):
        number = repr if self.kind == "double" else shortest_single
        lines = [f"scene {self.name} {self.kind}"]

        def line(word, *numbers):
            lines.append(" ".join([word] + ["0" if x == 0 else number(x).removesuffix(".0") for x in numbers]))

        if self.constant:
            line("constant", self.constant)
        if any(self.acceleration):
            line("acceleration", *self.acceleration)
        if self.damping != 1:
            line("damping", self.damping)
        if any(self.drag):
            line("drag", *self.drag)
        for p in self.particles:
            line("particle", *p)
        for time, states, others in zip(self.times, *self.solve(self)):
            lines.append(f"# {digits(states, others)} digits")
            lines.append("at " + repr(time).removesuffix(".0"))
            for state in states:
                lines.append(" ".join(["end"] + ["0" if x == 0 else f"{x:.35e}" for x in state]))
        return "\n".join(lines)


def length(v):
    return sqrt(sum(x * x for x in v))


def digits(states, others):
    worst = 60
    for state, other in zip(states, others):
        for part in (slice(0, 3), slice(3, 6)):
            apart = length([x - y for x, y in zip(state[part], other[part])])
            if apart:
                worst = min(worst, int(-gmpy2.log10(apart / length(state[part]))))
    return worst


def product(a, b, n):
    """Coefficient n of the product of two series."""
    return sum(map(mul, a[: n + 1], b[n::-1]))


def power(s, u, exponent, n):
    """Coefficient n of u = s^exponent, from s u' = exponent s' u."""
    if n == 0:
        return s[0] ** exponent
    return sum((exponent * k - (n - k)) * s[k] * u[n - k] for k in range(1, n + 1)) / (n * s[0])


def taylor(scene, order, accuracy):
    """The states at all times, by steps such that the last coefficients are about `accuracy` of the first."""
    pull = [exact(g) for g in scene.pulls()]
    bodies = range(len(pull))
    pairs = [(i, j) for i in bodies for j in bodies if i < j and (pull[i] or pull[j])]
    acceleration = [exact(x) for x in scene.acceleration]
    rate = gmpy2.log(exact(scene.damping))
    k1, k2 = (exact(x) for x in scene.drag)
    half, cube = mpfr(0.5), mpfr(-1.5)

    def series(states):
        x = [[[s[c]] for c in range(3)] for s in states]
        v = [[[s[c + 3]] for c in range(3)] for s in states]
        d = [([], [], []) for _ in pairs]
        s, u = ([[] for _ in pairs] for _ in range(2))
        square, resistance = ([[] for _ in bodies] for _ in range(2))
        for n in range(order):
            change = [[rate * v[i][c][n] + (acceleration[c] if n == 0 else 0) for c in range(3)] for i in bodies]
            if k1 or k2:
                for i in bodies:
                    square[i].append(sum(product(v[i][c], v[i][c], n) for c in range(3)))
                    # The speed.
                    resistance[i].append(power(square[i], resistance[i], half, n))
                    for c in range(3):
                        change[i][c] -= k1 * v[i][c][n] + k2 * product(resistance[i], v[i][c], n)
            for p, (i, j) in enumerate(pairs):
                for c in range(3):
                    d[p][c].append(x[j][c][n] - x[i][c][n])
                s[p].append(sum(product(d[p][c], d[p][c], n) for c in range(3)))
                u[p].append(power(s[p], u[p], cube, n))
                for c in range(3):
                    w = product(d[p][c], u[p], n)
                    change[i][c] += pull[j] * w
                    change[j][c] -= pull[i] * w
            for i in bodies:
                for c in range(3):
                    x[i][c].append(v[i][c][n] / (n + 1))
                    v[i][c].append(change[i][c] / (n + 1))
        return [x[i] + v[i] for i in bodies]

    def value(coefficients, h):
        sum = mpfr(0)
        for a in reversed(coefficients):
            sum = sum * h + a
        return sum

    states, now, answers = scene.states(), mpfr(0), []
    for time in map(exact, scene.times):
        while now < time:
            all = series(states)
            longest = time - now
            for s in all:
                for part in (s[:3], s[3:]):
                    for n in (order - 1, order):
                        last, first = (length([a[k] for a in part]) for k in (n, 0))
                        if last and first:
                            longest = min(longest, (accuracy * first / last) ** (mpfr(1) / n))
            states = [[value(a, longest) for a in s] for s in all]
            now = time if longest == time - now else now + longest
        answers.append(states)
    return answers


def two_series(scene):
    return taylor(scene, 50, mpfr("1e-52")), taylor(scene, 42, mpfr("1e-47"))


def damped(scene):
    def state(s, t):
        rate = -gmpy2.log(exact(scene.damping))
        e = gmpy2.exp(-rate * t)
        phi, psi = (1 - e) / rate, (rate * t - 1 + e) / rate**2
        a = [exact(x) for x in scene.acceleration]
        return [s[c] + s[c + 3] * phi + a[c] * psi for c in range(3)] + [s[c + 3] * e + a[c] * phi for c in range(3)]

    return [[state(s, exact(t)) for s in scene.states()] for t in scene.times], taylor(scene, 50, mpfr("1e-52"))


def two_bodies(scene):
    """Around the centre of mass, which moves uniformly, with Kepler's equation for the change E of eccentric anomaly."""
    m1, m2 = (exact(p[1]) for p in scene.particles)
    mu = exact(scene.constant) * (m1 + m2)
    s1, s2 = scene.states()
    start = [b - a for a, b in zip(s1, s2)]
    centre = [(m1 * a + m2 * b) / (m1 + m2) for a, b in zip(s1, s2)]
    r0 = length(start[:3])
    a = 1 / (2 / r0 - length(start[3:]) ** 2 / mu)
    motion = sqrt(mu / a**3)
    cosine, sine = 1 - r0 / a, sum(map(mul, start[:3], start[3:])) / sqrt(mu * a)

    def states(t):
        m = motion * t
        e = m
        for _ in range(2000):
            # Newton, bridled at first.
            error = e - cosine * gmpy2.sin(e) + sine * (1 - gmpy2.cos(e)) - m
            change = error / (1 - cosine * gmpy2.cos(e) + sine * gmpy2.sin(e))
            e -= max(min(change, mpfr(0.5)), mpfr(-0.5))
            if abs(change) < mpfr("1e-84") * (1 + m):
                break
        else:
            raise ArithmeticError("Kepler's equation")
        c, s = gmpy2.cos(e), gmpy2.sin(e)
        r = a * (1 - cosine * c + sine * s)
        f, g = 1 - a / r0 * (1 - c), t - (e - s) / motion
        df, dg = -sqrt(mu * a) * s / (r * r0), 1 - a / r * (1 - c)
        apart = [f * x + g * v for x, v in zip(start[:3], start[3:])] + [df * x + dg * v for x, v in zip(start[:3], start[3:])]
        middle = [x + t * v for x, v in zip(centre[:3], centre[3:])] + centre[3:]
        return [[x + share * y for x, y in zip(middle, apart)] for share in (-m2 / (m1 + m2), m1 / (m1 + m2))]

    return [states(exact(t)) for t in scene.times], taylor(scene, 50, mpfr("1e-52"))


def long_run(scene):
    """By scenes.cpp, with two steps that divide all the times."""
    directory = tempfile.TemporaryDirectory()
    program = os.path.join(directory.name, "scenes")
    source = os.path.join(os.path.dirname(os.path.abspath(__file__)), "scenes.cpp")
    subprocess.run(["g++", "-O3", "-march=native", "-o", program, source], check=True)

    def fixed(x):
        return f"{round(x * 2**200) % 2**224:056x}"

    def number(word):
        n = int(word, 16)
        return mpfr(n - (n >> 223 << 224)) / 2**200

    def run(order, step):
        lines = [f"{len(scene.particles)} {order} {len(scene.times)}"]
        lines += [str(Fraction(t) / step) for t in scene.times]
        for g, p in zip(scene.pulls(), scene.particles):
            lines += [fixed(g * step**2)] + [fixed(Fraction(x)) for x in p[2:5]] + [fixed(Fraction(v) * step) for v in p[5:]]
        output = subprocess.run([program], input="\n".join(lines), capture_output=True, text=True, check=True).stdout.split()
        numbers = iter([number(word) for word in output])
        answers = []
        for _ in scene.times:
            answers.append([])
            for _ in scene.particles:
                pairs = [(next(numbers), next(numbers) / exact(step)) for _ in range(3)]
                answers[-1].append([x for x, _ in pairs] + [v for _, v in pairs])
        return answers

    return run(72, Fraction("146.1")), run(64, Fraction("121.75"))


def turned(v):
    """By a rotation of no simple axis and angle: that of the quaternion (5, 3, -2, 4)."""
    w, x, y, z = 5, 3, -2, 4
    rows = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    return [sum(map(mul, row, v)) / mpfr(54) for row in rows]


def orbit(m1, m2, constant, position, velocity):
    """Two bodies apart by position and velocity, their centre of mass at rest, rounded."""
    whole = exact(m1) + exact(m2)
    return [[m, m] + [float(share * x) for x in position + velocity] for m, share in ((m1, -exact(m2) / whole), (m2, exact(m1) / whole))]


def periods(*counts):
    return [float(2 * gmpy2.const_pi() * n) for n in counts]


def kepler():
    m1, m2, constant = 1.0, 1e-3, 1 / 1.001
    mu = exact(constant) * (exact(m1) + exact(m2))
    e = mpfr("0.9")
    # The pericentre of semi-major axis 1.
    particles = orbit(m1, m2, constant, turned([1 - e, 0, 0]), turned([0, sqrt(mu * (1 + e) / (1 - e)), 0]))
    return Scene("kepler", two_bodies, periods(1, 10, 100, 1000), particles, constant)


def circular():
    particles = orbit(0.5, 0.5, 1.0, [mpfr(1), mpfr(0), mpfr(0)], [mpfr(0), mpfr(1), mpfr(0)])
    return Scene("circular", two_bodies, periods(1, 10, 100), particles, 1.0)


def pleiades():
    x, y = (3, 3, -1, -3, 2, -2, 2), (3, -3, 2, 0, 0, -4, 4)
    vx, vy = (0, 0, 0, 0, 0, 1.75, -1.5), (0, 0, 0, -1.25, 1, 0, 0)
    particles = [(m, m, x[m - 1], y[m - 1], 0, vx[m - 1], vy[m - 1], 0) for m in range(1, 8)]
    return Scene("pleiades", two_series, [1.0, 2.0, 3.0], particles, 1.0)


def arenstorf():
    mu, x, v = 0.012277471, 0.994, mpfr("-2.00158510637908252240537862224")
    rest = 0.987722529  # 1 - mu
    # In the frame at rest, where the satellite has what the turning frame adds.
    v = float(v + mpfr("0.994"))
    particles = [(rest, rest, -mu, 0, 0, 0, -mu, 0), (mu, mu, rest, 0, 0, 0, rest, 0), (1, 0, x, 0, 0, 0, v, 0)]
    return Scene("arenstorf", two_series, [10.0, 17.0652165601579625588917206249], particles, 1.0)


def outer():
    """The Sun with the inner planets, Jupiter to Neptune, and Pluto without mass: Applegate et al. 1986, AJ 92, 176."""
    masses = [1.00000597682, 1 / 1047.355, 1 / 3501.6, 1 / 22869, 1 / 19314, 0]
    positions = [
        [-4.06428567034226e-3, -6.08813756435987e-3, -1.66162304225834e-6],
        [+3.40546614227466e0, +3.62978190075864e0, +3.42386261766577e-2],
        [+6.60801554403466e0, +6.38084674585064e0, -1.36145963724542e-1],
        [+1.11636331405597e1, +1.60373479057256e1, +3.61783279369958e-1],
        [-3.01777243405203e1, +1.91155314998064e0, -1.53887595621042e-1],
        [-2.13858977531573e1, +3.20719104739886e1, +2.49245689556096e0],
    ]
    velocities = [
        [+6.69048890636161e-6, -6.33922479583593e-6, -3.13202145590767e-9],
        [-5.59797969310664e-3, +5.51815399480116e-3, -2.66711392865591e-6],
        [-4.17354020307064e-3, +3.99723751748116e-3, +1.67206320571441e-5],
        [-3.25884806151064e-3, +2.06438412905916e-3, -2.17699042180559e-5],
        [-2.17471785045538e-4, -3.11361111025884e-3, +3.58344705491441e-5],
        [-1.76936577252484e-3, -2.06720938381724e-3, +6.58091931493844e-4],
    ]
    k = 0.01720209895
    states = [[exact(x) for x in p + v] for p, v in zip(positions, velocities)]
    weights = [exact(m) for m in masses]
    centre = [sum(map(mul, weights, column)) / sum(weights) for column in zip(*states)]
    particles = [[m or 1.0, m] + [float(x - c) for x, c in zip(s, centre)] for m, s in zip(masses, states)]
    # 10 to 100000 Julian years, in days.
    return Scene("outer", long_run, [3652.5, 36525.0, 365250.0, 3652500.0, 36525000.0], particles, k * k)


thrown = [(1, 0, 0, 0, 0, 30, 40, 5)]
down = (0.0, -9.81, 0.0)
scenes = [
    Scene("base", damped, [1.0, 10.0], thrown, acceleration=down, damping=0.5),
    Scene("weak", damped, [1.0, 100.0, 1e6 / 60], thrown, acceleration=down, damping=0.999),
    Scene("drag", two_series, [1.0, 10.0], thrown, acceleration=down, drag=(0.2, 0.1)),
    kepler(),
    outer(),
    pleiades(),
    arenstorf(),
    circular(),
]

if __name__ == "__main__":
    chosen = [s for s in scenes if len(sys.argv) == 1 or s.name in sys.argv[1:]]
    print("# Written by scenes.py, which says what the lines mean. Each number of digits is how far two solutions agree.")
    with ProcessPoolExecutor(2) as pool:
        for text in pool.map(Scene.text, [s for scene in chosen for s in (scene, scene.single())]):
            print(text, flush=True)
