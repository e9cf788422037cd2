/* Rows of a CSV file from float64 values: each as the shortest decimal that is read back as the same value.
 *
 * The decimal is the one that Python's repr gives. It is found with one 128-bit power of ten per value, by the method of
 * R. Giulietti, "The Schubfach way to render doubles" (2020): with v = c 2^q and 10^k just below the width of the interval
 * of all numbers that are read back as v, at most one multiple of 10^(k+1) is inside of it. If there is none, the multiple
 * of 10^k that is closest to v is the shortest one. All quantities are four times as large, so that the ends of the
 * interval, v + 2^q/2 and v - 2^q/2 (or 2^q/4 below a power of two), are whole numbers times 2^q.
 */

#include <stdint.h>
#include <string.h>

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

typedef unsigned __int128 Wide;

enum { FIRST_POWER = -292, FRACTION = 52, BIAS = 1075, DIGITS = 17 };

/* floor(q log10(2)), floor(q log10(2) + log10(3/4)) and floor(n log2(10)), for all exponents of float64 (Giulietti, 2020) */
static int decimal_exponent(int q, int below_power) {
    return (int)(((int64_t)q * 1262611 - (below_power ? 524031 : 0)) >> 22);
}
static int binary_exponent(int n) { return (int)(((int64_t)n * 1741647) >> 19); }

/* (power cp) / 2^128, rounded to odd: the last bit also says whether the quotient is not whole. */
static uint64_t scaled(const uint64_t *power, uint64_t cp) {
    const Wide low = (Wide)power[0] * cp, high = (Wide)power[1] * cp + (uint64_t)(low >> 64);
    return (uint64_t)(high >> 64) | ((uint64_t)high > 1);
}

/* The digits of the shortest decimal, digits 10^*exponent; bits: those of a positive finite value. */
static uint64_t shortest(uint64_t bits, const uint64_t *powers, int *exponent) {
    const int biased = (int)(bits >> FRACTION);
    const uint64_t fraction = bits & (((uint64_t)1 << FRACTION) - 1);
    const uint64_t c = biased ? fraction | (uint64_t)1 << FRACTION : fraction;
    const int q = (biased ? biased : 1) - BIAS, below_power = !fraction && biased > 1;
    const int k = decimal_exponent(q, below_power), shift = q + binary_exponent(-k) + 1;
    const uint64_t *power = powers + 2 * (-k - FIRST_POWER), odd = c & 1;
    const uint64_t low = scaled(power, (4 * c - 2 + (uint64_t)below_power) << shift) + odd;
    const uint64_t v = scaled(power, (4 * c) << shift), high = scaled(power, (4 * c + 2) << shift) - odd;
    const uint64_t s = v / 4, tens = s / 10;
    *exponent = k + 1;
    if (tens) {
        const int below = low <= 40 * tens, above = 40 * tens + 40 <= high;
        if (below != above) return tens + (uint64_t)above;
    }
    *exponent = k;
    const int below = low <= 4 * s, above = 4 * s + 4 <= high;
    if (below != above) return s + (uint64_t)above;
    return s + (v > 4 * s + 2 || (v == 4 * s + 2 && (s & 1)));
}

static char *put(char *text, const char *from, int64_t n) { return (char *)memcpy(text, from, (size_t)n) + n; }

static char *zeros(char *text, int n) { return (char *)memset(text, '0', (size_t)n) + n; }

/* Writes a value in the notation of Python's repr; returns the end of the text. */
static char *number(char *text, double value, const uint64_t *powers) {
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    const int negative = (int)(bits >> 63);
    bits = bits << 1 >> 1;
    if (bits > (uint64_t)0x7ff << FRACTION) return put(text, "nan", 3);
    if (negative) *text++ = '-';
    if (bits == (uint64_t)0x7ff << FRACTION) return put(text, "inf", 3);
    if (!bits) return put(text, "0.0", 3);
    int exponent;
    uint64_t rest = shortest(bits, powers, &exponent);
    char all[DIGITS + 3], *first = all + sizeof all;
    for (; rest; rest /= 10) *--first = (char)('0' + rest % 10);
    int n = (int)(all + sizeof all - first);
    int point = n + exponent; /* digits before the decimal point */
    while (n > 1 && first[n - 1] == '0') n--;
    if (point > 16 || point < -3) {
        *text++ = *first;
        if (n > 1) {
            *text++ = '.';
            text = put(text, first + 1, n - 1);
        }
        int power = point - 1;
        *text++ = 'e';
        *text++ = power < 0 ? '-' : '+';
        if (power < 0) power = -power;
        if (power >= 100) *text++ = (char)('0' + power / 100);
        *text++ = (char)('0' + power / 10 % 10);
        *text++ = (char)('0' + power % 10);
        return text;
    }
    if (point <= 0) return put(zeros(put(text, "0.", 2), -point), first, n);
    if (point >= n) return put(zeros(put(text, first, n), point - n), ".0", 2);
    text = put(text, first, point);
    *text++ = '.';
    return put(text, first + point, n - point);
}

/* Writes rows as lines, with at most 25 characters a value; returns the number of characters.
 *
 * powers   10^n for n = FIRST_POWER to 324 as two halves, the lower one first: rounded up to 128 significant bits
 */
EXPORT int64_t csv_rows(const double *values, int64_t rows, int64_t columns, const uint64_t *powers, char *text) {
    const char *begin = text;
    for (int64_t row = 0; row < rows; row++) {
        for (int64_t column = 0; column < columns; column++) {
            text = number(text, *values++, powers);
            *text++ = ',';
        }
        text[-1] = '\n';
    }
    return text - begin;
}
