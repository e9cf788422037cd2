/* What a module of WebAssembly needs of the C library: memory, texts, and the formats of our messages.

   The compiler has wasi-libc only as 650 source files, which it compiles for half a minute before its first module. Its
   run-time library, which has the elementary functions, takes a sixth of that. A model that needs more is linked with
   wasi-libc (`fmus.export.compile`). The tests compile this file for the computer, too, with other names. */

#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#ifndef NAMED
#define NAMED(name) name
#endif

#ifdef __wasm__
/* What is not in the run-time library: the power, by musl. Its sources come with the compiler. */
#include "pow_data.c"
#undef N
#include "exp_data.c"
#undef N
#undef A
#include "__math_invalid.c"
#include "__math_oflow.c"
#include "__math_uflow.c"
#include "__math_xflow.c"
#include "pow.c"

void _initialize(void) {} /* called first, as in each module for WASI without a main */

/* ---- memory: blocks of powers of two, each kept for the next request of its size ---------------------------- */

enum { PAGE = 65536, HEAD = 16, LARGEST = 31 };

typedef struct Block {
    size_t power;
    struct Block *next; /* of those that are free */
} Block;

static Block *kept[LARGEST];
static uintptr_t top, limit;

static void *taken(size_t size) {
    if (!limit) top = limit = __builtin_wasm_memory_size(0) * PAGE;
    if (size > limit - top) {
        const size_t pages = (size - (limit - top) + PAGE - 1) / PAGE;
        if (__builtin_wasm_memory_grow(0, pages) == SIZE_MAX) return NULL;
        limit += pages * PAGE;
    }
    top += size;
    return (void *)(top - size);
}

void *malloc(size_t size) {
    size_t power = 5;
    while (power < LARGEST && ((size_t)1 << power) < size + HEAD) power++;
    if (power == LARGEST || size > SIZE_MAX - HEAD) return NULL;
    Block *block = kept[power];
    if (block) kept[power] = block->next;
    else if ((block = taken((size_t)1 << power))) block->power = power;
    return block ? (char *)block + HEAD : NULL;
}

void free(void *memory) {
    if (!memory) return;
    Block *block = (Block *)((char *)memory - HEAD);
    block->next = kept[block->power];
    kept[block->power] = block;
}

void *calloc(size_t count, size_t size) {
    void *memory = size && count > SIZE_MAX / size ? NULL : malloc(count * size);
    return memory ? __builtin_memset(memory, 0, count * size) : NULL;
}
#endif

/* ---- texts --------------------------------------------------------------------------------------------------- */

size_t NAMED(strlen)(const char *text) {
    size_t n = 0;
    while (text[n]) n++;
    return n;
}

int NAMED(strcmp)(const char *a, const char *b) {
    while (*a && *a == *b) a++, b++;
    return (unsigned char)*a - (unsigned char)*b;
}

char *NAMED(strcpy)(char *target, const char *text) {
    char *end = target;
    while ((*end++ = *text++)) continue;
    return target;
}

size_t NAMED(strspn)(const char *text, const char *accepted) {
    size_t n = 0;
    for (; text[n]; n++) {
        const char *a = accepted;
        while (*a && *a != text[n]) a++;
        if (!*a) break;
    }
    return n;
}

/* ---- formats: %s, %d, %u, %zu, %g with digits, %% ------------------------------------------------------------- */

typedef struct {
    char *text;
    size_t size, used; /* `used` counts what does not fit, too */
} Output;

static void put(Output *o, char c) {
    if (o->used + 1 < o->size) o->text[o->used] = c;
    o->used++;
}

static void put_text(Output *o, const char *text) {
    while (*text) put(o, *text++);
}

/* At least `width` digits. */
static void put_whole(Output *o, uint64_t value, int width) {
    char digits[24];
    int n = 0;
    do digits[n++] = (char)('0' + value % 10);
    while ((value /= 10) || n < width);
    while (n) put(o, digits[--n]);
}

/* value * 10^power, with 64 bits or more: enough for 17 digits */
static long double scaled(long double value, int power) {
    long double factor = 1.0L, ten = 10.0L;
    for (int n = power < 0 ? -power : power; n; n /= 2, ten *= ten)
        if (n % 2) factor *= ten;
    return power < 0 ? value / factor : value * factor;
}

static void put_number(Output *o, double number, int precision) {
    if (number != number) {
        put_text(o, "nan");
        return;
    }
    if (__builtin_signbit(number)) put(o, '-');
    long double value = number < 0 ? -number : number;
    if (value > 1.7976931348623157e308L) {
        put_text(o, "inf");
        return;
    }
    if (precision < 1) precision = 1;
    int exponent = 0;
    uint64_t digits = 0, most = 1; /* `precision` digits and 10^precision */
    for (int n = 0; n < precision; n++) most *= 10;
    if (value > 0) {
        while (scaled(value, -exponent) >= 10.0L) exponent++;
        while (scaled(value, -exponent) < 1.0L) exponent--;
        const long double exact = scaled(value, precision - 1 - exponent);
        digits = (uint64_t)exact;
        const long double rest = exact - (long double)digits;
        if (rest > 0.5L || (rest == 0.5L && digits % 2)) digits++;
        if (digits == most) digits /= 10, exponent++;
    }
    char text[24];
    for (int n = precision; n; digits /= 10) text[--n] = (char)('0' + digits % 10);
    int count = precision;
    while (count > 1 && text[count - 1] == '0') count--;
    if (exponent < -4 || exponent >= precision) {
        put(o, text[0]);
        if (count > 1) put(o, '.');
        for (int n = 1; n < count; n++) put(o, text[n]);
        put_text(o, exponent < 0 ? "e-" : "e+");
        put_whole(o, (uint64_t)(exponent < 0 ? -exponent : exponent), 2);
        return;
    }
    if (exponent < 0) put_text(o, "0.");
    for (int n = exponent + 1; n < 0; n++) put(o, '0');
    for (int n = 0; n < count || n <= exponent; n++) {
        put(o, n < count ? text[n] : '0');
        if (n == exponent && n + 1 < count) put(o, '.');
    }
}

int NAMED(vsnprintf)(char *text, size_t size, const char *format, va_list arguments) {
    Output o = {text, size, 0};
    for (const char *f = format; *f; f++) {
        if (*f != '%') {
            put(&o, *f);
            continue;
        }
        int precision = 6, is_size = 0;
        if (*++f == '.' && f[1] == '*') precision = va_arg(arguments, int), f += 2;
        else if (*f == '.')
            for (precision = 0, f++; *f >= '0' && *f <= '9'; f++) precision = 10 * precision + *f - '0';
        if (*f == 'z') is_size = 1, f++;
        if (*f == 's') put_text(&o, va_arg(arguments, const char *));
        else if (*f == 'g') put_number(&o, va_arg(arguments, double), precision);
        else if (*f == 'u') put_whole(&o, is_size ? va_arg(arguments, size_t) : va_arg(arguments, unsigned), 1);
        else if (*f == 'd') {
            const int value = va_arg(arguments, int);
            if (value < 0) put(&o, '-');
            put_whole(&o, value < 0 ? 0u - (unsigned)value : (unsigned)value, 1);
        } else put(&o, *f);
    }
    if (size) text[o.used < size ? o.used : size - 1] = '\0';
    return (int)o.used;
}

int NAMED(snprintf)(char *text, size_t size, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    const int used = NAMED(vsnprintf)(text, size, format, arguments);
    va_end(arguments);
    return used;
}
