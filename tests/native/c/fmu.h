/* What the driver does with an FMU of either version: fmu2.c, fmu3.c. Functions that return an int return the
   status of FMI, 0 when all is well. */

#ifndef FMU_H
#define FMU_H

#include <stddef.h>

void fmu_load(const char *path);
void fmu_unload(void);

void *fmu_make(const char *name, const char *token, int co_simulation);
int fmu_begin(void *c, double start, double tolerance); /* to initialization mode */
int fmu_end(void *c, int co_simulation);                /* to step mode or continuous-time mode */
int fmu_reset(void *c);
void fmu_free(void *c);

int fmu_set(void *c, unsigned reference, double value);
int fmu_get(void *c, const unsigned references[], size_t n, double values[]);
int fmu_slopes(void *c, const unsigned references[], size_t n, double values[]); /* of outputs */
int fmu_along(void *c, unsigned unknown, unsigned known, double *value);

int fmu_step(void *c, double time, double length);
int fmu_euler(void *c, double time, double length, size_t states); /* model exchange: one explicit step */

int fmu_save(void *c, void **state);
int fmu_restore(void *c, void *state);
int fmu_forget(void *c, void **state);
int fmu_size(void *c, void *state, size_t *size);
int fmu_pack(void *c, void *state, char bytes[], size_t size);
int fmu_unpack(void *c, const char bytes[], size_t size, void **state);

#endif
