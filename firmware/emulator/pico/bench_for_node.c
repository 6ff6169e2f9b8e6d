/* The bench (boards/host/bench.h) for a program that runs on node: the motor behind the emulated Pico is the one behind
 * every other emulated board. A shared library that node loads.
 *
 *     make([[name, value], ...])     a bench at time 0; names and values as of bench_option. Throws what is wrong with them
 *     advance(bench, t_s)            then all others speak of that time
 *     drive(bench, units)            arm(bench)
 *     position(bench)                tachometer(bench): counts, negative where there is none
 *     encoder(bench)                 [steps, how far to the next one, counts/s]
 *     levels(bench, steps)           of the encoder's channels: 1 for A, 2 for B
 *     contacts(bench)                that are open: 1 the e-stop's, 2 and 4 the ends' at falling and at rising counts
 *     rewire(bench, drive, sensor)   place(bench, y_rad, v_rad_per_s)
 *     look(bench)                    [pin_V, motor_V, y_rad, v_rad_per_s, supply_V]
 */
#include <math.h>
#include <node_api.h>
#include <stdlib.h>

#include "bench.h"

#define TEXT_MAX 128
#define ARGUMENTS_MAX 3

typedef struct {
    size_t count;
    napi_value at[ARGUMENTS_MAX];
} arguments;

static napi_value undefined(napi_env env)
{
    napi_value value = NULL;
    (void)napi_get_undefined(env, &value);
    return value;
}

static arguments take(napi_env env, napi_callback_info info)
{
    arguments given = {.count = ARGUMENTS_MAX};
    (void)napi_get_cb_info(env, info, &given.count, given.at, NULL, NULL);
    return given;
}

/* The first argument; NULL with an exception pending where it is no bench. */
static bench *bench_of(napi_env env, const arguments *given)
{
    void *data = NULL;
    if (given->count < 1u || napi_get_value_external(env, given->at[0], &data) != napi_ok) {
        (void)napi_throw_type_error(env, NULL, "the first argument is a bench");
        return NULL;
    }
    return data;
}

static double number_of(napi_env env, napi_value value)
{
    double given = 0.0;
    (void)napi_get_value_double(env, value, &given);
    return given;
}

static void text_of(napi_env env, napi_value value, char text[TEXT_MAX])
{
    size_t length = 0;
    text[0] = '\0';
    (void)napi_get_value_string_utf8(env, value, text, TEXT_MAX, &length);
}

static napi_value number(napi_env env, double value)
{
    napi_value made = NULL;
    (void)napi_create_double(env, value, &made);
    return made;
}

static void end_bench(napi_env env, void *data, void *hint)
{
    (void)env;
    (void)hint;
    free(data);
}

static const char *set_option(napi_env env, napi_value pair, bench_params *params)
{
    napi_value name_value = NULL;
    napi_value text_value = NULL;
    char name[TEXT_MAX], text[TEXT_MAX];
    (void)napi_get_element(env, pair, 0, &name_value);
    (void)napi_get_element(env, pair, 1, &text_value);
    text_of(env, name_value, name);
    text_of(env, text_value, text);
    return bench_option(params, name, text);
}

static napi_value make(napi_env env, napi_callback_info info)
{
    const arguments given = take(env, info);
    bench_params params;
    bench_defaults(&params);
    uint32_t count = 0;
    (void)napi_get_array_length(env, given.at[0], &count);
    const char *wrong = NULL;
    for (uint32_t i = 0; i < count && wrong == NULL; i++) {
        napi_value pair = NULL;
        (void)napi_get_element(env, given.at[0], i, &pair);
        wrong = set_option(env, pair, &params);
    }
    wrong = wrong != NULL ? wrong : bench_check(&params);
    bench *made = wrong == NULL ? malloc(sizeof *made) : NULL;
    if (made == NULL) {
        (void)napi_throw_error(env, NULL, wrong != NULL ? wrong : "no memory for a bench");
        return NULL;
    }
    bench_init(made, &params);
    napi_value value = NULL;
    (void)napi_create_external(env, made, end_bench, NULL, &value);
    return value;
}

static napi_value advance(napi_env env, napi_callback_info info)
{
    const arguments given = take(env, info);
    bench *b = bench_of(env, &given);
    if (b != NULL) {
        bench_advance_to(b, number_of(env, given.at[1]));
    }
    return undefined(env);
}

static napi_value drive(napi_env env, napi_callback_info info)
{
    const arguments given = take(env, info);
    bench *b = bench_of(env, &given);
    if (b != NULL) {
        bench_set_drive(b, (int32_t)number_of(env, given.at[1]));
    }
    return undefined(env);
}

static napi_value arm(napi_env env, napi_callback_info info)
{
    const arguments given = take(env, info);
    bench *b = bench_of(env, &given);
    if (b != NULL) {
        bench_arm(b);
    }
    return undefined(env);
}

static napi_value position(napi_env env, napi_callback_info info)
{
    const arguments given = take(env, info);
    bench *b = bench_of(env, &given);
    return b != NULL ? number(env, bench_position_counts(b)) : NULL;
}

static napi_value tachometer(napi_env env, napi_callback_info info)
{
    const arguments given = take(env, info);
    const bench *b = bench_of(env, &given);
    return b != NULL ? number(env, bench_tachometer_counts(b)) : NULL;
}

static napi_value numbers(napi_env env, const double *values, uint32_t count)
{
    napi_value made = NULL;
    (void)napi_create_array(env, &made);
    for (uint32_t i = 0; i < count; i++) {
        (void)napi_set_element(env, made, i, number(env, values[i]));
    }
    return made;
}

static napi_value encoder(napi_env env, napi_callback_info info)
{
    const arguments given = take(env, info);
    bench *b = bench_of(env, &given);
    if (b == NULL) {
        return NULL;
    }
    double to_next;
    const int64_t steps = bench_encoder_steps(b, &to_next);
    const double seen[] = {(double)steps, to_next, fabs(b->v_rad_per_s / b->p.rad_per_count)};
    return numbers(env, seen, 3);
}

static napi_value levels(napi_env env, napi_callback_info info)
{
    const arguments given = take(env, info);
    bench *b = bench_of(env, &given);
    return b != NULL ? number(env, bench_encoder_levels(b, (int64_t)number_of(env, given.at[1]))) : NULL;
}

static napi_value contacts(napi_env env, napi_callback_info info)
{
    const arguments given = take(env, info);
    const bench *b = bench_of(env, &given);
    if (b == NULL) {
        return NULL;
    }
    return number(env, (bench_estop_is_open(b) ? 1.0 : 0.0) + (bench_end_is_open(b, false) ? 2.0 : 0.0) +
                           (bench_end_is_open(b, true) ? 4.0 : 0.0));
}

static napi_value rewire(napi_env env, napi_callback_info info)
{
    const arguments given = take(env, info);
    bench *b = bench_of(env, &given);
    char drive_name[TEXT_MAX], sensor_name[TEXT_MAX];
    if (b == NULL) {
        return NULL;
    }
    text_of(env, given.at[1], drive_name);
    text_of(env, given.at[2], sensor_name);
    const char *wrong = bench_rewire(b, drive_name, sensor_name);
    if (wrong != NULL) {
        (void)napi_throw_error(env, NULL, wrong);
    }
    return undefined(env);
}

static napi_value place(napi_env env, napi_callback_info info)
{
    const arguments given = take(env, info);
    bench *b = bench_of(env, &given);
    if (b != NULL) {
        b->y_rad = number_of(env, given.at[1]);
        b->v_rad_per_s = number_of(env, given.at[2]);
    }
    return undefined(env);
}

static napi_value look(napi_env env, napi_callback_info info)
{
    const arguments given = take(env, info);
    const bench *b = bench_of(env, &given);
    if (b == NULL) {
        return NULL;
    }
    const double seen[] = {bench_pin_V(b), bench_motor_V(b), b->y_rad, b->v_rad_per_s, b->p.supply_V};
    return numbers(env, seen, sizeof seen / sizeof seen[0]);
}

NAPI_MODULE_INIT()
{
    static const struct {
        const char *name;
        napi_callback function;
    } ALL[] = {{"make", make},         {"advance", advance}, {"drive", drive}, {"arm", arm},  {"position", position},
               {"tachometer", tachometer}, {"rewire", rewire},   {"place", place}, {"look", look},
               {"encoder", encoder},   {"levels", levels},   {"contacts", contacts}};
    for (unsigned i = 0; i < sizeof ALL / sizeof ALL[0]; i++) {
        napi_value function = NULL;
        (void)napi_create_function(env, ALL[i].name, NAPI_AUTO_LENGTH, ALL[i].function, NULL, &function);
        (void)napi_set_named_property(env, exports, ALL[i].name, function);
    }
    return exports;
}
