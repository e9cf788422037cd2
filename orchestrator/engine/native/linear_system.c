/* Linearised components joined by their connections to one linear system, with n states and m inputs:
 *
 *     d' = f + A d + B v,     v = C d + D v + w
 *
 * d: changes of the states, v: changes of the inputs, w: the part of v that comes from outside. A and B are blocks of
 * directional derivatives of the components. C and D contain the factors of the connections, too. With
 * K = 1 / (1 - D),  v = K (C d + w)  and  d' = f + (A + B K C) d + B K w.
 *
 * In LinearSystem: `matrices` contains A, B, C and D, each column by column. kc: K C; closed_loop: A + B K C.
 * has_feedthrough: D is not 0. usable: K exists.
 */

#include <math.h>
#include <string.h>

#include "engine.h"

/* ---- matrices, stored column by column; rows are padded to a multiple of BLOCK */

/* to += matrix by */
void matrix_add_product(const double *matrix, const double *by, double *to, int32_t columns, int32_t n_padded) {
    for (int32_t first = 0; first < n_padded; first += BLOCK) {
        double sum[BLOCK];
        memcpy(sum, to + first, sizeof sum);
        for (int32_t j = 0; j < columns; j++) {
            if (by[j] == 0.0) continue;
            for (int i = 0; i < BLOCK; i++) sum[i] += matrix[j * n_padded + first + i] * by[j];
        }
        memcpy(to + first, sum, sizeof sum);
    }
}

static void subtract_row(double *restrict to, const double *restrict row, double factor, int32_t n_padded) {
    for (int32_t first = 0; first < n_padded; first += BLOCK)
        for (int j = 0; j < BLOCK; j++) to[first + j] -= row[first + j] * factor;
}

static void exchange(double *a, double *b, int32_t n, int32_t stride) {
    for (int32_t j = 0; j < n; j++) {
        const double old = a[j * stride];
        a[j * stride] = b[j * stride], b[j * stride] = old;
    }
}

/* Replaces a matrix by its inverse; 0 if it is singular. */
int32_t matrix_invert(double *a, int32_t *pivots, int32_t n, int32_t n_padded) {
    for (int32_t k = 0; k < n; k++) {
        double *column = a + k * n_padded;
        int32_t best = k;
        for (int32_t i = k + 1; i < n; i++)
            if (fabs(a[i * n_padded + k]) > fabs(a[best * n_padded + k])) best = i;
        pivots[k] = best;
        if (best != k) exchange(column, a + best * n_padded, n, 1);
        const double pivot = column[k];
        if (pivot == 0.0 || !(fabs(pivot) < INFINITY)) return 0;
        column[k] = 1.0;
        for (int32_t j = 0; j < n_padded; j++) column[j] /= pivot;
        for (int32_t i = 0; i < n; i++) {
            double *other = a + i * n_padded;
            const double factor = other[k];
            if (i == k || factor == 0.0) continue;
            other[k] = 0.0;
            subtract_row(other, column, factor, n_padded);
        }
    }
    for (int32_t k = n - 1; k >= 0; k--)
        if (pivots[k] != k) exchange(a + k, a + pivots[k], n, n_padded);
    return 1;
}

static void subtract_part(double *restrict to, const double *restrict from, double factor, int32_t first, int32_t end) {
    for (int32_t i = first; i < end; i++) to[i] -= from[i] * factor;
}

/* Replaces a matrix by its triangular factors, with the inverse of each pivot; 0 if it is singular. */
int32_t matrix_factorise(double *a, int32_t *pivots, int32_t n, int32_t n_padded) {
    for (int32_t k = 0; k < n; k++) {
        double *column = a + k * n_padded;
        int32_t best = k;
        for (int32_t i = k + 1; i < n; i++)
            if (fabs(column[i]) > fabs(column[best])) best = i;
        pivots[k] = best;
        if (best != k) exchange(a + k, a + best, n, n_padded);
        if (column[k] == 0.0 || !(fabs(column[k]) < INFINITY)) return 0;
        const double inverse = column[k] = 1.0 / column[k];
        for (int32_t i = k + 1; i < n; i++) column[i] *= inverse;
        for (int32_t j = k + 1; j < n; j++) {
            double *other = a + j * n_padded;
            if (other[k] != 0.0) subtract_part(other, column, other[k], k + 1, n);
        }
    }
    return 1;
}

/* block -= part of the columns `from` to `end` of a matrix, times x */
static void subtract_product(const double *rows, const double *x, double block[], int32_t from, int32_t end, int32_t n_padded) {
    for (int32_t j = from; j < end; j++)
        for (int i = 0; i < BLOCK; i++) block[i] -= rows[j * n_padded + i] * x[j];
}

/* Solves a x = b with the factors of a, by blocks of rows; x replaces b. */
void matrix_solve(const double *a, const int32_t *pivots, double *b, int32_t n, int32_t n_padded) {
    double block[BLOCK];
    for (int32_t k = 0; k < n; k++) {
        const double old = b[k];
        b[k] = b[pivots[k]], b[pivots[k]] = old;
    }
    for (int32_t first = 0; first < n_padded; first += BLOCK) {
        const double *rows = a + first;
        const int32_t count = n - first < BLOCK ? n - first : BLOCK;
        memcpy(block, b + first, sizeof block);
        subtract_product(rows, b, block, 0, first, n_padded);
        for (int32_t k = 0; k < count; k++)
            for (int32_t i = k + 1; i < count; i++) block[i] -= rows[(first + k) * n_padded + i] * block[k];
        memcpy(b + first, block, sizeof block);
    }
    for (int32_t first = n_padded - BLOCK; first >= 0; first -= BLOCK) {
        const double *rows = a + first;
        const int32_t count = n - first < BLOCK ? n - first : BLOCK;
        memcpy(block, b + first, sizeof block);
        subtract_product(rows, b, block, first + count, n, n_padded);
        for (int32_t k = count - 1; k >= 0; k--) {
            block[k] *= rows[(first + k) * n_padded + k];
            for (int32_t i = 0; i < k; i++) block[i] -= rows[(first + k) * n_padded + i] * block[k];
        }
        memcpy(b + first, block, sizeof block);
    }
}

/* a = the identity matrix minus `factor` times a matrix */
void matrix_identity_minus(double *a, const double *matrix, double factor, int32_t n, int32_t n_padded) {
    for (int32_t i = 0; i < n; i++)
        for (int32_t j = 0; j < n_padded; j++) a[i * n_padded + j] = (i == j) - factor * matrix[i * n_padded + j];
}

/* ---- the system */

StateSpace state_space(const LinearSystem *p) {
    const double *a = p->matrices, *b = a + p->n * p->n_padded;
    const double *c = b + p->m * p->n_padded, *d = c + p->n * p->m_padded;
    return (StateSpace){a, b, c, d};
}

/* Linearises the components where they are. */
int linear_system_evaluate(Simulation *sim, const LinearSystem *p) {
    return linearise(sim, p->columns, p->column_count, p->matrices);
}

/* Computes K, K C and A + B K C. */
void linear_system_join(LinearSystem *p) {
    const int32_t n = p->n, m = p->m, n_padded = p->n_padded, m_padded = p->m_padded;
    const StateSpace system = state_space(p);
    p->usable = 1;
    vector_copy(p->kc, system.c, n * m_padded);
    if (p->has_feedthrough) {
        matrix_identity_minus(p->k, system.d, 1.0, m, m_padded);
        p->usable = matrix_invert(p->k, p->pivots, m, m_padded);
        vector_zero(p->kc, n * m_padded);
        for (int32_t j = 0; j < n; j++)
            matrix_add_product(p->k, system.c + j * m_padded, p->kc + j * m_padded, m, m_padded);
    }
    vector_copy(p->closed_loop, system.a, n * n_padded);
    for (int32_t j = 0; j < n; j++)
        matrix_add_product(system.b, p->kc + j * m_padded, p->closed_loop + j * n_padded, m, n_padded);
}

/* The response of all inputs to changes w from outside: K w. */
void linear_system_respond(const LinearSystem *p, const double *w, double *response) {
    if (!p->has_feedthrough) {
        vector_copy(response, w, p->m_padded);
        return;
    }
    vector_zero(response, p->m_padded);
    matrix_add_product(p->k, w, response, p->m, p->m_padded);
}
