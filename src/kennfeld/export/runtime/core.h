/* One instance of an exported function: its values, its memory and its clock. The interfaces of FMI 2 and 3 call it.

   The generated header model.h defines for the function:

   MODEL(x)       its name before _x, such as torque_step
   PLACES         where variables are, by their value references
   STEP           the step in s
   FIXED_STEP     1 if steps of another length are an error: its memory counts steps
   AT_START       1 if inputs belong to the start of a step, 0 if to its end
   USES_DT, USES_DT_NEXT, USES_T, HAS_MEMORY
*/
#ifndef KENNFELD_CORE_H
#define KENNFELD_CORE_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "model.h"

#if defined(_WIN32)
#define EXPORTED __declspec(dllexport)
#elif defined(__GNUC__)
#define EXPORTED __attribute__((visibility("default")))
#else
#define EXPORTED
#endif

typedef enum { PLACE_INPUT, PLACE_OUTPUT, PLACE_PARAMETER, PLACE_TIME } place_kind;

/* variable: the struct that it is in, its offset there, and its number of values */
typedef struct {
    place_kind kind;
    size_t offset;
    size_t count;
} place;

static const place places[] = PLACES;
#define PLACE_COUNT (sizeof(places) / sizeof(places[0]))

typedef enum { PHASE_CREATED, PHASE_INITIALIZING, PHASE_RUNNING, PHASE_ENDED } phase;

/* 1 if the last sample has to be computed once more when the length of the step behind it is known */
#define COMPUTES_AGAIN (!AT_START && HAS_MEMORY && (USES_DT || USES_DT_NEXT))

/* what a saved state holds */
typedef struct {
    MODEL(parameters) p;
    MODEL(inputs) u;
    MODEL(outputs) y;
    MODEL(states) s;      /* after the last sample */
    MODEL(states) before; /* before it, as its derivatives and a step of another length need */
    MODEL(inputs) used;   /* inputs of that sample */
    double start;
    double time;
    double last_step; /* 0 before the first one */
    int32_t samples;  /* 2 if more than one */
#if COMPUTES_AGAIN
    MODEL(parameters) used_p; /* parameters of the last sample */
    int32_t tuned;            /* 1 if parameters were set behind it */
#endif
    int32_t stale;    /* 1 if outputs are older than inputs, parameters or time */
    phase now;
} instance_data;

static void set_clock(MODEL(inputs) *u, double step, double next, double time)
{
    (void)u;
    (void)step;
    (void)next;
    (void)time;
#if USES_DT
    u->dt = step;
#endif
#if USES_DT_NEXT
    u->dt_next = next;
#endif
#if USES_T
    u->t = time;
#endif
}

static void reset_data(instance_data *d)
{
    memset(d, 0, sizeof(*d));
    d->p = MODEL(defaults);
    MODEL(init)(&d->s);
    d->before = d->s;
#if COMPUTES_AGAIN
    d->tuned = 1;
#endif
    d->stale = 1;
    d->now = PHASE_CREATED;
}

/* computes a sample, and moves the memory on */
static void take_sample(instance_data *d, double step, double next, double time)
{
    d->before = d->s;
    d->used = d->u;
    set_clock(&d->used, step, next, time);
    MODEL(step)(&d->p, &d->s, &d->used, &d->y);
#if COMPUTES_AGAIN
    if (d->tuned != 0) {
        d->used_p = d->p;
        d->tuned = 0;
    }
#endif
    d->samples = (d->samples < 2) ? (d->samples + 1) : 2;
    d->stale = 0;
}

/* outputs for the present inputs, without moving the memory on */
static void refresh(instance_data *d)
{
    if (d->stale != 0) {
        const double step = (d->last_step > 0.0) ? d->last_step : STEP;
        MODEL(states) trial = d->s;

        d->before = d->s;
        d->used = d->u;
        set_clock(&d->used, step, step, d->time - d->start);
        MODEL(step)(&d->p, &trial, &d->used, &d->y);
        d->stale = 0;
    }
}

/* the sample at the start of the simulation */
static void end_initialization(instance_data *d)
{
    d->stale = 1;
#if !AT_START && HAS_MEMORY
    take_sample(d, STEP, STEP, 0.0);
#else
    refresh(d);
#endif
    d->now = PHASE_RUNNING;
}

static int32_t is_allowed(double step)
{
#if FIXED_STEP
    return (fabs(step - STEP) <= (1e-6 * STEP)) ? 1 : 0;
#else
    return ((step > 0.0) && (step <= 1e300)) ? 1 : 0;
#endif
}

static void do_step(instance_data *d, double time, double step)
{
#if AT_START
    /* the first step before a sample is as long as the one behind it */
    take_sample(d, (d->last_step > 0.0) ? d->last_step : step, step, time - d->start);
#else
#if COMPUTES_AGAIN
    /* the length of this step is the one behind the last sample, and before the first one: computed once more */
    if (USES_DT_NEXT || (d->samples == 1)) {
        const double earlier = (d->samples == 1) ? step : d->last_step;
        MODEL(inputs) past = d->used;
        MODEL(outputs) ignored;

        set_clock(&past, earlier, step, d->time - d->start);
        d->s = d->before;
        MODEL(step)(&d->used_p, &d->s, &past, &ignored);
    }
#endif
    take_sample(d, step, step, (time + step) - d->start);
#endif
    d->last_step = step;
    d->time = time + step;
}

static double *values_of(const place *at, MODEL(parameters) *p, MODEL(inputs) *u, MODEL(outputs) *y)
{
    char *base = (char *)p;

    if (at->kind == PLACE_INPUT) {
        base = (char *)u;
    } else if (at->kind == PLACE_OUTPUT) {
        base = (char *)y;
    } else {
        /* a parameter */
    }
    return (double *)(void *)(base + at->offset);
}

/* 1 if outputs belong to the inputs that are set now, 0 if to those before the last step */
static int32_t follows_inputs(const instance_data *d)
{
    return ((d->now == PHASE_INITIALIZING) || (HAS_MEMORY == 0) || (AT_START != 0)) ? 1 : 0;
}

/* copies values of variables; 0 if a reference is unknown or there are not as many values */
static int32_t get_values(instance_data *d, const uint32_t *references, size_t count, double *values, size_t room)
{
    size_t k;
    size_t filled = 0;

    for (k = 0; k < count; k++) {
        const place *at;

        if ((references[k] >= PLACE_COUNT) || ((filled + places[references[k]].count) > room)) {
            return 0;
        }
        at = &places[references[k]];
        if (at->kind == PLACE_TIME) {
            values[filled] = d->time;
        } else {
            if ((at->kind == PLACE_OUTPUT) && (follows_inputs(d) != 0)) {
                refresh(d);
            }
            memcpy(&values[filled], values_of(at, &d->p, &d->u, &d->y), at->count * sizeof(double));
        }
        filled += at->count;
    }
    return (filled == room) ? 1 : 0;
}

static int32_t set_values(instance_data *d, const uint32_t *references, size_t count, const double *values, size_t room)
{
    size_t k;
    size_t read = 0;

    for (k = 0; k < count; k++) {
        const place *at;

        if ((references[k] >= PLACE_COUNT) || ((read + places[references[k]].count) > room)) {
            return 0;
        }
        at = &places[references[k]];
        if ((at->kind != PLACE_INPUT) && (at->kind != PLACE_PARAMETER)) {
            return 0;
        }
        memcpy(values_of(at, &d->p, &d->u, &d->y), &values[read], at->count * sizeof(double));
        read += at->count;
    }
#if COMPUTES_AGAIN
    d->tuned = 1;
#endif
    d->stale = 1;
    return (read == room) ? 1 : 0;
}

/* the change of unknowns, which are outputs, for a change of knowns, which are inputs or parameters */
static int32_t get_derivative(instance_data *d, const uint32_t *unknowns, size_t unknown_count, const uint32_t *knowns,
    size_t known_count, const double *seed, size_t seeds, double *sensitivity, size_t sensitivities)
{
    MODEL(parameters) dp;
    MODEL(inputs) du;
    MODEL(outputs) dy;
    size_t k;
    size_t at = 0;

    memset(&dp, 0, sizeof(dp));
    memset(&du, 0, sizeof(du));
    memset(&dy, 0, sizeof(dy));
    for (k = 0; k < known_count; k++) {
        const place *from;

        if ((knowns[k] >= PLACE_COUNT) || ((at + places[knowns[k]].count) > seeds)) {
            return 0;
        }
        from = &places[knowns[k]];
        if ((from->kind != PLACE_INPUT) && (from->kind != PLACE_PARAMETER)) {
            return 0;
        }
        memcpy(values_of(from, &dp, &du, &dy), &seed[at], from->count * sizeof(double));
        at += from->count;
    }
    if (follows_inputs(d) != 0) {
        refresh(d);
    }
    MODEL(tangent)(&d->p, &d->before, &d->used, &dp, &du, &dy);
    at = 0;
    for (k = 0; k < unknown_count; k++) {
        const place *to;

        if ((unknowns[k] >= PLACE_COUNT) || (places[unknowns[k]].kind != PLACE_OUTPUT) || (at >= sensitivities)) {
            return 0;
        }
        to = &places[unknowns[k]];
        sensitivity[at] = *values_of(to, &dp, &du, &dy);
        at++;
    }
    return (at == sensitivities) ? 1 : 0;
}

#endif
