"""Writes motion.txt: powers and motions for tests/it, computed with 80 digits and more by mpmath 1.3 or later.

    pip install mpmath && python3 tests/reference/motion.py > tests/reference/motion.txt

Every number is the bits of a double in hexadecimal. Two kinds of lines, with damping d and time or step length t:

    power d h D        D the double nearest to d^h
    motion d t E phi psi, then for x, y and z: p0 v0 a, and the true position and velocity as two doubles each

E, phi and psi are the coefficients of src/closed_form.rs. Every p0, v0, a and d is a single too.
"""

import random
import struct

from mpmath import log, mp, mpf

mp.dps = 80
random.seed(20261122)


def bits(x):
    return f"{struct.unpack('<Q', struct.pack('<d', x))[0]:016x}"


def single(x):
    return struct.unpack("<f", struct.pack("<f", x))[0]


# tests/it/naive.rs has the same two lists: dampings, and (duration, number of steps).
dampings = [1e-30, 0.001, 0.1, 0.5, 0.75, 0.9, 0.95, 0.99, 0.999, 1 - 2**-23]
plans = [(1 / 60, 1), (1 / 60, 3), (0.1, 7), (1.0, 60), (2.5, 64), (2.5, 150), (0.3, 2)]

powers = set()
for damping in dampings:
    for duration, steps in plans:
        powers.add((damping, duration / steps))
        powers.add((single(damping), single(duration / steps)))
for damping, step in sorted(powers):
    # No power of these is near enough to half a last place for 80 digits to leave a doubt.
    print("power", bits(damping), bits(step), bits(float(mpf(damping) ** mpf(step))))


def two_doubles(x):
    hi = float(x)
    return f"{bits(hi)} {bits(float(x - mpf(hi)))}"


def motion(d, t):
    mp.dps = 80
    d, t = mpf(d), mpf(t)
    if d == 1:
        return mpf(1), t, t * t / 2
    rate = -log(d)
    # What the cancellation in psi takes away, twice.
    mp.dps = 80 + 2 * max(0, int(-log(rate * t, 10)))
    rate = -log(d)
    e = mp.exp(-rate * t)
    return e, (1 - e) / rate, (rate * t - 1 + e) / rate**2


rows = 0
while rows < 200:
    kind = rows % 4
    if kind == 0:
        d = single(random.choice(dampings + [1.0]))
    elif kind == 1:
        d = single(1 - 2 ** random.uniform(-24, 0))
    else:
        d = single(10 ** random.uniform(-37, 0))
    t = 10 ** random.uniform(-6, 5) if kind % 2 else random.choice([1 / 60, 0.1, 1.0, 7.3, 60.0, 3600.0])
    if not 0 < d <= 1 or t * -log(d) > 60:
        continue
    e, phi, psi = motion(d, t)
    words = [bits(float(x)) for x in (e, phi, psi)]
    for _ in range(3):
        p, v, a = (single(random.choice([-1, 1]) * 10 ** random.uniform(-4, 5)) for _ in range(3))
        words += [bits(p), bits(v), bits(a)]
        words += [two_doubles(p + (v * phi + a * psi)), two_doubles(v * e + a * phi)]
    print("motion", bits(d), bits(t), *words)
    rows += 1
