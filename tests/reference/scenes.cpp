// The long run of scenes.py: gravitation by Taylor series of a fixed step, in fixed point of 224 bits, 200 of them
// behind the point. The step is the unit of time.
//
// Input: number of bodies, order, number of marks, the marks (in steps, ascending); then for each body G m and the
// three coordinates of position and velocity. Output: at each mark the positions and velocities of all bodies. Numbers
// are 56 hexadecimal digits, two's complement.

#include <cmath>
#include <cstdint>
#include <cstdio>
#include <vector>

typedef int64_t i64;
typedef __int128 i128;

const int LIMBS = 4, BITS = 56, FRACTION = 200;
const i64 MASK = ((i64)1 << BITS) - 1;

// The lower limbs are from 0 to MASK, the highest has the sign.
struct Fixed {
    i64 w[LIMBS] = {0, 0, 0, 0};
};

static inline Fixed operator+(const Fixed &a, const Fixed &b) {
    Fixed c;
    i64 carry = 0;
    for (int i = 0; i < LIMBS; i++) {
        i64 t = a.w[i] + b.w[i] + carry;
        c.w[i] = i < LIMBS - 1 ? t & MASK : t;
        carry = t >> BITS;
    }
    return c;
}

static inline Fixed operator-(const Fixed &a, const Fixed &b) {
    Fixed c;
    i64 carry = 0;
    for (int i = 0; i < LIMBS; i++) {
        i64 t = a.w[i] - b.w[i] + carry;
        c.w[i] = i < LIMBS - 1 ? t & MASK : t;
        carry = t >> BITS;
    }
    return c;
}

// Times a small whole number, not negative.
static inline Fixed times(const Fixed &a, int k) {
    Fixed c;
    i64 carry = 0;
    for (int i = 0; i < LIMBS; i++) {
        i128 t = (i128)a.w[i] * k + carry;
        c.w[i] = i < LIMBS - 1 ? (i64)t & MASK : (i64)t;
        carry = (i64)(t >> BITS);
    }
    return c;
}

// A sum of at most 2^8 products, without the two lowest columns, which are less than 2^-20 of the last place.
struct Sum {
    i128 column[2 * LIMBS - 1] = {0, 0, 0, 0, 0, 0, 0};

    inline void add(const Fixed &a, const Fixed &b) {
        for (int i = 0; i < LIMBS; i++)
            for (int j = 0; j < LIMBS; j++)
                if (i + j >= 2) column[i + j] += (i128)a.w[i] * b.w[j];
    }

    inline void twice() {
        for (i128 &c : column) c += c;
    }

    // The sum shifted by FRACTION bits, which are three limbs and 32 bits.
    inline Fixed rounded() const {
        Fixed c;
        i64 low[6];
        i128 t = column[2];
        for (int i = 3; i < 6; i++) {
            t = column[i] + (t >> BITS) + (i == 3 ? (i64)1 << 31 : 0);
            low[i] = (i64)t & MASK;
        }
        t = column[6] + (t >> BITS);
        c.w[0] = (low[3] >> 32 | low[4] << 24) & MASK;
        c.w[1] = (low[4] >> 32 | low[5] << 24) & MASK;
        c.w[2] = (low[5] >> 32 | (i64)t << 24) & MASK;
        c.w[3] = (i64)(t >> 32);
        return c;
    }
};

static inline Fixed operator*(const Fixed &a, const Fixed &b) {
    Sum s;
    s.add(a, b);
    return s.rounded();
}

// Of x >= 0.
static Fixed fixed(double x) {
    Fixed c;
    x = std::ldexp(x, FRACTION - (LIMBS - 1) * BITS);
    for (int i = LIMBS - 1; i >= 0; i--) {
        c.w[i] = (i64)x;
        x = std::ldexp(x - (double)c.w[i], BITS);
    }
    return c;
}

static double nearly(const Fixed &a) {
    double x = 0;
    for (int i = 0; i < LIMBS; i++) x += std::ldexp((double)a.w[i], i * BITS - FRACTION);
    return x;
}

// 1/sqrt(a) of a > 0 by Newton's iteration.
static Fixed inverse_root(const Fixed &a) {
    Fixed y = fixed(1 / std::sqrt(nearly(a))), three = fixed(3), half = fixed(0.5);
    for (int i = 0; i < 4; i++) y = y * half * (three - a * (y * y));
    return y;
}

static Fixed inverse(int k) {
    Fixed c;
    i128 rest = (i64)1 << (FRACTION - (LIMBS - 1) * BITS);
    for (int i = LIMBS - 1; i >= 0; i--) {
        c.w[i] = (i64)(rest / k);
        rest = (rest % k) << BITS;
    }
    return c;
}

static Fixed read() {
    Fixed c;
    for (int i = LIMBS - 1; i >= 0; i--)
        if (std::scanf("%14lx", &c.w[i]) != 1) throw 1;
    if (c.w[LIMBS - 1] >> (BITS - 1)) c.w[LIMBS - 1] -= (i64)1 << BITS;
    return c;
}

static void write(const Fixed &a) {
    for (int i = LIMBS - 1; i >= 0; i--) std::printf("%014lx", a.w[i] & MASK);
    std::printf("\n");
}

int main() {
    int n, order, marks;
    if (std::scanf("%d %d %d", &n, &order, &marks) != 3) return 1;
    std::vector<long> mark(marks);
    for (long &m : mark)
        if (std::scanf("%ld", &m) != 1) return 1;

    typedef std::vector<Fixed> Series;
    std::vector<Fixed> gm(n);
    std::vector<Series> x(3 * n, Series(order + 1));
    for (int i = 0; i < n; i++) {
        gm[i] = read();
        for (int c = 0; c < 3; c++) x[3 * i + c][0] = read();
        for (int c = 0; c < 3; c++) x[3 * i + c][1] = read();
    }
    std::vector<bool> heavy(n);
    for (int i = 0; i < n; i++) heavy[i] = gm[i].w[0] || gm[i].w[1] || gm[i].w[2] || gm[i].w[3];
    std::vector<Fixed> inverses(order * order + 2 * order + 1);
    for (size_t k = 1; k < inverses.size(); k++) inverses[k] = inverse(k);

    // Of a pair: its distance vector d, s = d.d, u = s^(-3/2).
    struct Pair {
        int i, j;
        Series d[3], s, u;
        Fixed inverse_s;
    };
    std::vector<Pair> pairs;
    for (int i = 0; i < n; i++)
        for (int j = i + 1; j < n; j++)
            if (heavy[i] || heavy[j]) {
                Series zero(order + 1);
                pairs.push_back({i, j, {zero, zero, zero}, zero, zero, Fixed()});
            }

    long step = 0;
    for (long m : mark) {
        for (; step < m; step++) {
            for (int k = 0; k + 2 <= order; k++) {
                for (int i = 0; i < 3 * n; i++) x[i][k + 2] = Fixed();
                for (Pair &p : pairs) {
                    Sum s;
                    for (int c = 0; c < 3; c++) {
                        Series &d = p.d[c];
                        d[k] = x[3 * p.j + c][k] - x[3 * p.i + c][k];
                        for (int l = 0; 2 * l < k; l++) s.add(d[l], d[k - l]);
                    }
                    s.twice();
                    if (k % 2 == 0)
                        for (int c = 0; c < 3; c++) s.add(p.d[c][k / 2], p.d[c][k / 2]);
                    p.s[k] = s.rounded();
                    if (k == 0) {
                        Fixed y = inverse_root(p.s[0]);
                        p.inverse_s = y * y;
                        p.u[0] = p.inverse_s * y;
                    } else {
                        // From s u' = -3/2 s' u.
                        Sum t;
                        for (int l = 1; l <= k; l++) t.add(times(p.s[l], l + 2 * k), p.u[k - l]);
                        p.u[k] = Fixed() - t.rounded() * p.inverse_s * inverses[2 * k];
                    }
                    for (int c = 0; c < 3; c++) {
                        Sum t;
                        for (int l = 0; l <= k; l++) t.add(p.d[c][l], p.u[k - l]);
                        Fixed pull = t.rounded();
                        Fixed &xi = x[3 * p.i + c][k + 2], &xj = x[3 * p.j + c][k + 2];
                        if (heavy[p.j]) xi = xi + gm[p.j] * pull;
                        if (heavy[p.i]) xj = xj - gm[p.i] * pull;
                    }
                }
                for (int i = 0; i < 3 * n; i++) x[i][k + 2] = x[i][k + 2] * inverses[(k + 1) * (k + 2)];
            }
            for (Series &q : x) {
                Fixed position, velocity;
                for (int k = order; k >= 0; k--) {
                    position = position + q[k];
                    velocity = velocity + times(q[k], k);
                }
                q[0] = position;
                q[1] = velocity;
            }
        }
        for (Series &q : x)
            for (int k = 0; k < 2; k++) write(q[k]);
    }
}
