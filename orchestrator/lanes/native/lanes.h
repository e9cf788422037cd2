/* Numbers of several machines at once: the type Lanes has one double per machine, in a vector of the processor.

   The C code of a model is compiled as C++ with Lanes in place of double. A comparison of Lanes is a Mask, with one
   truth value per machine; `where` is the only way to choose by it. The compiler maps the vectors to AVX-512, to two
   registers of AVX2, to four of SSE2 or NEON.

   exp, log, sin and cos have errors of a few units in the last place, pow that of its logarithm. Other functions of the
   C library are called for one machine after the other. */

#ifndef LANES_H
#define LANES_H

#include <math.h>

enum { LANES = 8 }; /* machines in a group, on all processors, so that a group has the same members on all of them */

typedef double Vector __attribute__((ext_vector_type(LANES)));
typedef decltype(Vector() < Vector()) Bits; /* integers of 64 bits; a truth value is 0 or -1 */

#define INLINE static inline __attribute__((always_inline))

struct Mask {
    Bits bits;
};

struct Lanes {
    Vector v;
    Lanes() = default;
    constexpr __attribute__((always_inline)) Lanes(double x) : v(x) {}
    __attribute__((always_inline)) Lanes(Vector x) : v(x) {}
    __attribute__((always_inline)) Lanes(Mask m) : v(m.bits ? Vector(1.0) : Vector(0.0)) {}
    __attribute__((always_inline)) double operator[](int lane) const { return v[lane]; }
};

/* ---- truth values ---------------------------------------------------------------------------- */

INLINE Mask operator<(Lanes a, Lanes b) { return {a.v < b.v}; }
INLINE Mask operator<=(Lanes a, Lanes b) { return {a.v <= b.v}; }
INLINE Mask operator>(Lanes a, Lanes b) { return {a.v > b.v}; }
INLINE Mask operator>=(Lanes a, Lanes b) { return {a.v >= b.v}; }
INLINE Mask operator==(Lanes a, Lanes b) { return {a.v == b.v}; }
INLINE Mask operator!=(Lanes a, Lanes b) { return {a.v != b.v}; }
INLINE Mask operator&&(Mask a, Mask b) { return {a.bits & b.bits}; }
INLINE Mask operator||(Mask a, Mask b) { return {a.bits | b.bits}; }
INLINE Mask operator!(Mask a) { return {~a.bits}; }
INLINE bool any(Mask m) { return __builtin_reduce_or(m.bits) != 0; }
INLINE bool all(Mask m) { return !any(!m); }
INLINE Lanes where(Mask condition, Lanes a, Lanes b) { return condition.bits ? a.v : b.v; }
INLINE Lanes where(Mask condition, Lanes a) { return condition.bits ? a.v : Vector(0.0); }

/* ---- arithmetic ------------------------------------------------------------------------------ */

#if defined(RECIPROCALS) && defined(__AVX512F__)
/* By Newton's method from a reciprocal with a relative error e below 2^-14: r (1 + e + e^2 + e^3). The error is two units
   in the last place. Meanwhile the divider of the processor, which takes three times as long, computes square roots. */
INLINE Vector quotient(Vector a, Vector b) {
    const Vector r = __builtin_ia32_rcp14pd512_mask(b, Vector(0.0), -1), e = 1.0 - b * r, squared = e * e;
    const Vector sum = e + squared;
    /* e is NaN if b is 0, infinite or NaN, and -infinite if 1 / b is too large for a number: then b counts as 0 */
    return a * (e > -1.0 ? r + r * (sum + sum * squared) : r);
}
#else
INLINE Vector quotient(Vector a, Vector b) { return a / b; }
#endif

INLINE Lanes operator+(Lanes a, Lanes b) { return a.v + b.v; }
INLINE Lanes operator-(Lanes a, Lanes b) { return a.v - b.v; }
INLINE Lanes operator*(Lanes a, Lanes b) { return a.v * b.v; }
INLINE Lanes operator/(Lanes a, Lanes b) { return quotient(a.v, b.v); }
INLINE Lanes operator-(Lanes a) { return -a.v; }
INLINE Lanes &operator+=(Lanes &a, Lanes b) { return a = a + b; }
INLINE Lanes &operator-=(Lanes &a, Lanes b) { return a = a - b; }
INLINE Lanes &operator*=(Lanes &a, Lanes b) { return a = a * b; }
INLINE Lanes &operator/=(Lanes &a, Lanes b) { return a = a / b; }
INLINE Lanes fabs(Lanes a) { return __builtin_elementwise_abs(a.v); }
INLINE Lanes sqrt(Lanes a) { return __builtin_elementwise_sqrt(a.v); }
INLINE Lanes floor(Lanes a) { return __builtin_elementwise_floor(a.v); }
INLINE Lanes ceil(Lanes a) { return __builtin_elementwise_ceil(a.v); }
INLINE Lanes copysign(Lanes a, Lanes b) { return __builtin_elementwise_copysign(a.v, b.v); }
INLINE Lanes fmax(Lanes a, Lanes b) { return a.v > b.v ? a.v : b.v; } /* b if one of them is NaN */
INLINE Lanes fmin(Lanes a, Lanes b) { return a.v < b.v ? a.v : b.v; }
INLINE double largest(Lanes a) { return __builtin_reduce_max(a.v); }
INLINE Mask finite(Lanes a) { return a - a == 0.0; }

/* ---- functions ------------------------------------------------------------------------------- */

/* Added to a number up to 2^51 in magnitude, it leaves the nearest integer in the low bits. */
static const double ROUNDING = 6755399441055744.0; /* 1.5 * 2^52 */

/* 2^n for whole numbers n from -1022 to 1023, given as n + ROUNDING. */
INLINE Vector power_of_two(Vector shifted) {
    return __builtin_bit_cast(Vector, (__builtin_bit_cast(Bits, shifted) + 1023) << 52);
}

/* Taylor series on |r| <= ln(2) / 2, with the remainder r^14 / 14! < 5e-18; ln(2) in two parts. */
INLINE Lanes exp(Lanes a) {
    Vector x = a.v > 710.0 ? Vector(710.0) : a.v; /* above it infinite; NaN stays */
    x = x < -746.0 ? Vector(-746.0) : x;          /* below it zero */
    const Vector shifted = x * 1.4426950408889634 + ROUNDING, n = shifted - ROUNDING;
    const Vector r = (x - n * 0.6931471803691238) - n * 1.9082149292705877e-10;
    Vector s = 1.0 / 6227020800.0;
    s = s * r + 1.0 / 479001600.0;
    s = s * r + 1.0 / 39916800.0;
    s = s * r + 1.0 / 3628800.0;
    s = s * r + 1.0 / 362880.0;
    s = s * r + 1.0 / 40320.0;
    s = s * r + 1.0 / 5040.0;
    s = s * r + 1.0 / 720.0;
    s = s * r + 1.0 / 120.0;
    s = s * r + 1.0 / 24.0;
    s = s * r + 1.0 / 6.0;
    s = s * r + 0.5;
    s = s * r + 1.0;
    s = s * r + 1.0;
    /* in two factors, so that results near the ends of the range are right */
    const Vector half = n * 0.5 + ROUNDING, rest = n - (half - ROUNDING) + ROUNDING;
    return s * power_of_two(half) * power_of_two(rest);
}

/* a = 2^n m with m from sqrt(1/2) to sqrt(2), and ln m = 2 artanh s, s = (m - 1) / (m + 1), |s| < 0.172; the remainder
   of the series is below 2 s^25 / 25 < 1e-20. */
INLINE Lanes log(Lanes a) {
    const Mask tiny = a < 2.2250738585072014e-308;
    const Vector x = (tiny.bits ? a.v * 18014398509481984.0 : a.v); /* 2^54 */
    const Bits bits = __builtin_bit_cast(Bits, x);
    /* the exponent, one more if the mantissa is above sqrt(2) */
    const Bits exponent = (bits - 0x3fe6a09e667f3bcd) >> 52;
    const Vector m = __builtin_bit_cast(Vector, bits - (exponent << 52));
    Vector n = __builtin_bit_cast(Vector, exponent + __builtin_bit_cast(Bits, Vector(ROUNDING))) - ROUNDING;
    n = n - (tiny.bits ? Vector(54.0) : Vector(0.0));
    const Vector s = (m - 1.0) / (m + 1.0), z = s * s;
    Vector r = 2.0 / 23.0;
    r = r * z + 2.0 / 21.0;
    r = r * z + 2.0 / 19.0;
    r = r * z + 2.0 / 17.0;
    r = r * z + 2.0 / 15.0;
    r = r * z + 2.0 / 13.0;
    r = r * z + 2.0 / 11.0;
    r = r * z + 2.0 / 9.0;
    r = r * z + 2.0 / 7.0;
    r = r * z + 2.0 / 5.0;
    r = r * z + 2.0 / 3.0;
    const Vector small = 2.0 * s + (s * z * r + n * 1.9082149292705877e-10);
    Lanes result = n * 0.6931471803691238 + small;
    result = where(a == INFINITY, a, result);
    result = where(a == 0.0, -INFINITY, result);
    return where(a >= 0.0, result, NAN);
}

/* x = k pi/2 + r with |r| <= pi/4, pi/2 in three parts; Taylor series of sine and cosine with a remainder below 1e-17.
   Exact for |k| < 2^20. */
enum { SINE, COSINE };
INLINE Lanes circular(Lanes a, int function) {
    const Vector x = a.v, shifted = x * 0.6366197723675814 + ROUNDING, k = shifted - ROUNDING;
    const Vector r = ((x - k * 1.5707963267341256) - k * 6.077100506303966e-11) - k * 2.0222662487959506e-21;
    const Vector z = r * r;
    Vector s = 1.0 / 355687428096000.0;
    s = s * z - 1.0 / 1307674368000.0;
    s = s * z + 1.0 / 6227020800.0;
    s = s * z - 1.0 / 39916800.0;
    s = s * z + 1.0 / 362880.0;
    s = s * z - 1.0 / 5040.0;
    s = s * z + 1.0 / 120.0;
    s = s * z - 1.0 / 6.0;
    s = r + r * z * s;
    Vector c = 1.0 / 20922789888000.0;
    c = c * z - 1.0 / 87178291200.0;
    c = c * z + 1.0 / 479001600.0;
    c = c * z - 1.0 / 3628800.0;
    c = c * z + 1.0 / 40320.0;
    c = c * z - 1.0 / 720.0;
    c = c * z + 1.0 / 24.0;
    c = c * z - 0.5;
    c = c * z + 1.0;
    const Bits quadrant = __builtin_bit_cast(Bits, shifted) + function;
    const Vector value = (quadrant & 1) != 0 ? c : s;
    return (quadrant & 2) != 0 ? -value : value;
}

/* A function of the C library for one machine after the other. */
#define ONE_BY_ONE(function)                                                                \
    static __attribute__((noinline)) Lanes function##_one_by_one(Lanes a) {                 \
        for (int i = 0; i < LANES; i++) a.v[i] = function((double)a.v[i]);                  \
        return a;                                                                           \
    }
#define ONE_BY_ONE_OF_TWO(function)                                                         \
    static __attribute__((noinline)) Lanes function##_one_by_one(Lanes a, Lanes b) {        \
        for (int i = 0; i < LANES; i++) a.v[i] = function((double)a.v[i], (double)b.v[i]);  \
        return a;                                                                           \
    }
ONE_BY_ONE(sin)
ONE_BY_ONE(cos)
ONE_BY_ONE_OF_TWO(pow)

static const double LARGE_ANGLE = 1e6; /* [rad] */
INLINE Lanes sin(Lanes a) { return any(fabs(a) > LARGE_ANGLE) ? sin_one_by_one(a) : circular(a, SINE); }
INLINE Lanes cos(Lanes a) { return any(fabs(a) > LARGE_ANGLE) ? cos_one_by_one(a) : circular(a, COSINE); }

INLINE Lanes pow(Lanes a, Lanes b) {
    if (any(a < 0.0 || b == 0.0)) return pow_one_by_one(a, b);
    return exp(b * log(a));
}

/* exp(a) of a value that is `least` or more, and most often `least`, whose exponential is known. */
INLINE Lanes exp_above(Lanes a, double least, double known) {
    const Mask above = a != least;
    return any(above) ? where(above, exp(a), known) : Lanes(known);
}

#define OTHER(function) ONE_BY_ONE(function) INLINE Lanes function(Lanes a) { return function##_one_by_one(a); }
#define OTHER_OF_TWO(function) \
    ONE_BY_ONE_OF_TWO(function) INLINE Lanes function(Lanes a, Lanes b) { return function##_one_by_one(a, b); }
OTHER(tan) OTHER(asin) OTHER(acos) OTHER(atan) OTHER(sinh) OTHER(cosh) OTHER(tanh) OTHER(asinh) OTHER(acosh) OTHER(atanh)
OTHER(erf) OTHER(log1p) OTHER(expm1)
OTHER_OF_TWO(fmod) OTHER_OF_TWO(remainder) OTHER_OF_TWO(atan2) OTHER_OF_TWO(hypot)

#endif
