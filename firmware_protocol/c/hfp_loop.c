/*
 * The position loop: i = clip(kp e + ki sum(e) T - kd v), v the backward difference of the angle through one pole at the
 * cutoff in its exact discrete form, the sum clamped so that its share alone never passes the limit. In a cascade the
 * sum is of e - t v, with the cascade time t. Single precision, but angles are compared as integers, so no resolution is
 * lost however far the motor has turned.
 */
#include "hfp_private.h"

#include <float.h>
#include <string.h>

static const float RAD_PER_RAW = 3.7450702829239286e-7F; /* 2 pi / 2^24 */
static const float TWO_PI = 6.2831853071795865F;
static const float INTEGRAL_MAX_RAW = 70368744177664.0F; /* 2^46: no sum of errors comes near the ends of 64 bits */

enum { LOW_HALF = 1 << 16 };

static bool is_no_less(float value, float least)
{
    return value >= least && value <= FLT_MAX; /* false for NaN */
}

static float clamped(float value, float limit)
{
    if (value > limit) {
        return limit;
    }
    return value < -limit ? -limit : value;
}

/* Nearest way round from one angle to another, modulo 2^32. */
static int32_t difference(int32_t to, int32_t from)
{
    return (int32_t)((uint32_t)to - (uint32_t)from);
}

/*
 * 1 - e^-x without libm: a series where x is small, then 1 - e^-2x = g (2 - g) with g = 1 - e^-x as often as x was
 * halved.
 */
static float one_minus_exp(float x)
{
    unsigned halved = 0;

    if (x > 32) {
        return 1;
    }
    for (; x > 0.03125F; halved++) {
        x *= 0.5F;
    }
    float gain = x * (1 - x / 2 * (1 - x / 3 * (1 - x / 4)));
    for (; halved > 0; halved--) {
        gain *= 2 - gain;
    }
    return gain;
}

/* Sums within INTEGRAL_MAX_RAW, without the double precision that compilers take for 64 bits. */
static float to_float(int64_t sum)
{
    return (float)(int32_t)(sum / LOW_HALF) * LOW_HALF + (float)(int32_t)(sum % LOW_HALF);
}

static int64_t to_sum(float value)
{
    int32_t high = (int32_t)(value / LOW_HALF);

    return (int64_t)high * LOW_HALF + (int32_t)(value - (float)high * LOW_HALF);
}

bool hfp_loop_init(hfp_loop *loop, const hfp_loop_config *config, int32_t theta_raw)
{
    float period_s = config->sample_time_s;

    if (!is_no_less(period_s, FLT_MIN) || !is_no_less(config->kp_A_per_rad, 0) ||
        !is_no_less(config->ki_A_per_rad_s, 0) || !is_no_less(config->kd_A_s_per_rad, 0) ||
        !is_no_less(config->derivative_cutoff_Hz, 0) || !is_no_less(config->current_limit_A, 0) ||
        !is_no_less(config->cascade_time_s, 0)) {
        return false;
    }
    memset(loop, 0, sizeof *loop);
    loop->theta_raw = theta_raw;
    loop->limit_A = config->current_limit_A;
    loop->proportional_A = config->kp_A_per_rad * RAD_PER_RAW;
    loop->integral_A = config->ki_A_per_rad_s * RAD_PER_RAW * period_s;
    loop->derivative_A = config->kd_A_s_per_rad * RAD_PER_RAW / period_s;
    loop->speed_gain = one_minus_exp(TWO_PI * config->derivative_cutoff_Hz * period_s);
    loop->cascade = config->cascade_time_s / period_s;
    if (loop->integral_A > 0) {
        float most = loop->limit_A / loop->integral_A;
        loop->integral_limit_raw = to_sum(most < INTEGRAL_MAX_RAW ? most : INTEGRAL_MAX_RAW);
    }
    return true;
}

static int64_t within(int64_t value, int64_t limit)
{
    if (value > limit) {
        return limit;
    }
    return value < -limit ? -limit : value;
}

/* What the speed takes from the integral at a sample; the rest of a unit waits for the next one. */
static int64_t speed_share(hfp_loop *loop)
{
    float wanted = clamped(loop->cascade * loop->speed_raw + loop->rest_raw, INTEGRAL_MAX_RAW);
    int64_t whole = to_sum(wanted);

    loop->rest_raw = wanted - to_float(whole);
    return whole;
}

float hfp_loop_step(hfp_loop *loop, bool active, int32_t reference_raw, int32_t theta_raw)
{
    int32_t moved = difference(theta_raw, loop->theta_raw);
    int32_t error = difference(reference_raw, theta_raw);

    loop->theta_raw = theta_raw;
    if (!active) { /* no old integral and no speed unseen can kick the motor when it starts */
        loop->integral_raw = 0;
        loop->speed_raw = 0;
        loop->rest_raw = 0;
        return 0;
    }
    loop->speed_raw += loop->speed_gain * ((float)moved - loop->speed_raw);
    loop->integral_raw = within(loop->integral_raw + error - speed_share(loop), loop->integral_limit_raw);
    return clamped(
        loop->proportional_A * (float)error + loop->integral_A * to_float(loop->integral_raw) -
            loop->derivative_A * loop->speed_raw,
        loop->limit_A);
}
