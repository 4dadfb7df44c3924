"""Writes closed_form.txt: E, phi and psi of src/closed_form/ computed with 700 digits by mpmath 1.3 or later.

    pip install mpmath && python3 tests/reference/closed_form.py > tests/reference/closed_form.txt

One line: the bits of damping and time in hexadecimal, then for E, phi and psi the bits of the nearest double and what
it lacks of the true value, in units of its last place.
"""

import random
import struct

from mpmath import floor, log, mp, mpf

mp.dps = 700
random.seed(20261122)


def bits(x):
    return struct.unpack("<Q", struct.pack("<d", x))[0]


def double(pattern):
    return struct.unpack("<d", struct.pack("<Q", pattern))[0]


def nearest(x):
    """The nearest double of x >= 0, rounded once also where it is subnormal, and the rest in its last places."""
    if x == 0:
        return 0.0, mpf(0)
    exponent = max(int(floor(log(x, 2))) - 52, -1074)
    units = x / mpf(2) ** exponent
    whole = floor(units + mpf("0.5"))
    return float(whole * mpf(2) ** exponent) if exponent > -1074 else double(int(whole)), units - whole


def coefficients(d, t):
    d, t = mpf(d), mpf(t)
    if d == 1:
        return mpf(1), t, t * t / 2
    if d == 0:
        return mpf(0), mpf(0), mpf(0)
    rate = -log(d)
    z = rate * t
    e = mp.exp(-z)
    return e, (1 - e) / rate, (z - 1 + e) / rate**2


cases = set()
edge_dampings = [0.0, 5e-324, 1e-310, 1e-300, 1e-9, 0.001, 0.1, 0.5, 0.9, 0.99, 0.995, 0.999, 1 - 2**-30, 1 - 2**-52, 1 - 2**-53, 1.0]
edge_times = [5e-324, 1e-310, 1e-300, 1e-160, 1e-154, 1e-30, 1e-9, 1 / 128, 1 / 60, 0.1, 0.5, 1.0, 10.0, 3600.0, 1e6, 5472929023.280485, 1e12]
for d in edge_dampings:
    for t in edge_times:
        cases.add((d, t))
cases.add((0.999999904286054, 5472929023.280485))
while len(cases) < 2500:
    kind = random.randrange(5)
    if kind == 0:
        d = random.random()
    elif kind == 1:
        d = 1 - 10 ** random.uniform(-16, 0)
    elif kind == 2:
        d = 10 ** random.uniform(-323, 0)
    else:
        d = double(random.randrange(bits(1.0)))
    t = 10 ** random.uniform(-12, 12)
    if kind == 4 and 0 < d < 1:
        # Where the cancellations and the change of formula are: z between 2^-4 and 2^6.
        t = float(mpf(2) ** random.uniform(-4, 6) / -log(mpf(d)))
    if 0 <= d <= 1 and 0 < t <= 1e12:
        cases.add((d, t))
while len(cases) < 2800:
    # Results about the smallest normal double: E by its exponent, phi and psi by the time.
    d = random.random()
    power = random.uniform(-1026, -1014)
    t = random.choice([power / float(log(mpf(d), 2)), 2.0**power, 2.0 ** (power / 2)])
    if 0 < d < 1 and 0 < t <= 1e12:
        cases.add((d, t))

for d, t in sorted(cases):
    row = [f"{bits(d):016x}", f"{bits(t):016x}"]
    for value in coefficients(d, t):
        rounded, rest = nearest(value)
        row.append(f"{bits(rounded):016x} {float(rest):+.4f}")
    print(" ".join(row))
