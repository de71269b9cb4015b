/* One host tick in plain C, for the ratio that docs/speed.md gives: what the same work takes without Python.
 *
 * Decode FEEDBACK, TIMING and BENCH_SENSOR with their CRC-8, pair and unwrap, estimate (`improved` or `kalman`),
 * compensate (10), gate, encode SETPOINT with its CRC-8. The arithmetic is that of firmware_protocol and
 * hil_forceps, operation by operation, so that a test can compare the references. Left out is what this stream has
 * no use for: samples over gaps (a stamp that is not one nominal period on ends the run), the approach, parameters.
 */

#include <math.h>
#include <stdint.h>
#include <string.h>

enum { SETPOINT = 0x02, FEEDBACK = 0x04, TIMING = 0x05, BENCH_SENSOR = 0x0A };
enum { OPERATIONAL = 2, KALMAN = 2, CLASSIC_LENGTH = 8 };
static const double ANGLE_LSB_RAD = 2.0 * 3.14159265358979323846 / 16777216.0;
static const double CURRENT_LSB_A = 2.0e-4;

typedef struct {
    uint16_t id;
    uint8_t length, is_fd;
    uint8_t data[8];
} frame_t;

typedef struct {
    double motor_radius_m, jaw_radius_m, torque_constant;
    double period_s, low_rad, high_rad, speed_max, acceleration_max;
    int64_t max_gap_ns, max_age_ns;
    int32_t node, points; /* of the trajectory */
    const double *times_s, *angles_rad;
    int32_t kind; /* of the estimator: 1 improved, 2 kalman */
    const double *constants, *stretch; /* the latter of `kalman`: 5 by 11 */
} config_t;

/* -- CRC-8 AUTOSAR over the id, little-endian, and the payload ---------------------------------------------------- */

static uint8_t crc_table[256];

static void make_crc_table(void)
{
    for (int value = 0; value < 256; value++) {
        uint8_t crc = (uint8_t)value;
        for (int bit = 0; bit < 8; bit++)
            crc = (uint8_t)(crc & 0x80 ? (crc << 1) ^ 0x2F : crc << 1);
        crc_table[value] = crc;
    }
}

static uint8_t crc8(uint16_t id, const uint8_t *data, int length)
{
    uint8_t crc = crc_table[0xFF ^ (id & 0xFF)];
    crc = crc_table[crc ^ (id >> 8)];
    for (int i = 0; i < length; i++)
        crc = crc_table[crc ^ data[i]];
    return crc ^ 0xFF;
}

static int is_intact(const frame_t *frame)
{
    return frame->length == CLASSIC_LENGTH && !frame->is_fd && crc8(frame->id, frame->data, 7) == frame->data[7];
}

static int32_t int24(const uint8_t *data)
{
    return (int32_t)((uint32_t)data[0] << 8 | (uint32_t)data[1] << 16 | (uint32_t)data[2] << 24) >> 8;
}

/* -- estimator `improved` ----------------------------------------------------------------------------------------- */

enum { I_RM, I_RJ, I_IM, I_IJ, I_DM, I_FM, I_FJ, I_A, I_CORNER, I_INERTIA };

typedef struct {
    int64_t time_ns;
    double angle, low_pass, tau_w, elongation, x, v, alpha;
} improved_t;

static double improved_elongation(const double *c, double known, double tau_ex, double jaw_friction)
{
    double b = c[I_RM] / c[I_IM] * known + c[I_RJ] / c[I_IJ] * jaw_friction;
    return (b + c[I_RJ] * c[I_RJ] / (c[I_RM] * c[I_IJ]) * tau_ex) / c[I_A];
}

static void improved_start(improved_t *s, const config_t *config, int64_t time_ns, double theta, double torque)
{
    const double *c = config->constants;
    double x_hat = improved_elongation(c, torque, torque, 0.0);
    *s = (improved_t){time_ns, theta, torque, c[I_RJ] / c[I_RM] * torque, x_hat, x_hat, 0.0, 0.0};
}

static void improved_step(improved_t *s, const config_t *config, int64_t time_ns, double theta, double torque)
{
    const double *c = config->constants;
    double dt = (double)(time_ns - s->time_ns) * 1e-9;
    double velocity = (theta - s->angle) / dt;
    double direction = velocity > 0.0 ? 1.0 : velocity < 0.0 ? -1.0 : velocity * 0.0;
    double known = torque - c[I_DM] * velocity - c[I_FM] * direction;
    double jaw_friction = c[I_FJ] * direction;
    double momentum = c[I_CORNER] * c[I_INERTIA] * velocity;
    double share = -expm1(-c[I_CORNER] * dt);
    s->low_pass += share * (known - c[I_RM] / c[I_RJ] * jaw_friction + momentum - s->low_pass);
    double tau_ex = s->low_pass - momentum;
    double x_hat = improved_elongation(c, known, tau_ex, jaw_friction);
    int steps = (int)ceil(dt * sqrt(c[I_A]));
    steps = steps < 2 ? 2 : steps;
    double h = dt / steps;
    for (int i = 0; i < steps; i++) {
        s->v += h * (c[I_A] * (x_hat - s->x) + s->alpha);
        s->x += h * s->v;
        s->alpha += h * h * (x_hat - s->x);
    }
    s->time_ns = time_ns;
    s->angle = theta;
    s->elongation = x_hat;
    s->tau_w = c[I_RJ] / c[I_RM] * tau_ex + c[I_IJ] / c[I_RJ] * s->alpha;
}

/* -- estimator `kalman` ------------------------------------------------------------------------------------------- */

enum { ANGLE_M, SPEED_M, ANGLE_J, SPEED_J, LOAD, STATES, TORQUE_COLUMN = 5, STEP_COLUMNS = 6, COLUMNS = 11 };
enum { FRICTION_SWEEPS = 3 };
/* The constants of `kalman_model` in an order of our own: KALMAN_CONSTANTS in test_host_tick.py. */
enum { TORQUE_VAR, ANGLE_VAR, FRICTION_M, FRICTION_J, DRIFT, STEP_VAR, STEP_RATE, LEAVE_RATE, RESTEP_RATE };
enum { RADIUS_M = RESTEP_RATE + 1, RADIUS_J, TURN_PER_LOAD };

typedef struct {
    double mean[STATES], covariance[STATES][STATES];
} hypothesis_t;

typedef struct {
    int64_t time_ns;
    double stepped_weight, tau_w, elongation;
    hypothesis_t quiet, stepped;
} kalman_t;

static double least(double a, double b) { return b < a ? b : a; }
static double most(double a, double b) { return b > a ? b : a; }

static void mix(hypothesis_t *out, double to_stay, const hypothesis_t *stay, double to_join, const hypothesis_t *join)
{
    double both = to_stay * to_join;
    for (int i = 0; i < STATES; i++) {
        out->mean[i] = to_stay * stay->mean[i] + to_join * join->mean[i];
        for (int j = 0; j < STATES; j++) {
            double spread = both * (stay->mean[i] - join->mean[i]) * (stay->mean[j] - join->mean[j]);
            out->covariance[i][j] = to_stay * stay->covariance[i][j] + to_join * join->covariance[i][j] + spread;
        }
    }
}

static void predict(hypothesis_t *h, const config_t *config, double torque, double step_var)
{
    const double *c = config->constants;
    const double(*over)[COLUMNS] = (const double(*)[COLUMNS])config->stretch;
    double half[STATES][STATES] = {{0.0}};
    hypothesis_t after;
    for (int i = 0; i < STATES; i++) {
        double mean = over[i][TORQUE_COLUMN] * torque;
        for (int j = 0; j < STATES; j++) {
            mean += over[i][j] * h->mean[j];
            for (int m = 0; m < STATES; m++)
                half[i][m] += over[i][j] * h->covariance[j][m];
        }
        after.mean[i] = mean;
    }
    double motor = 0.0, jaw = 0.0;
    for (int i = 0; i < FRICTION_SWEEPS; i++) {
        double left = after.mean[SPEED_M] - over[SPEED_M][TORQUE_COLUMN] * motor + over[SPEED_M][LOAD] * jaw;
        motor = most(-c[FRICTION_M], least(c[FRICTION_M], motor + left / over[SPEED_M][TORQUE_COLUMN]));
        left = after.mean[SPEED_J] - over[SPEED_J][TORQUE_COLUMN] * motor + over[SPEED_J][LOAD] * jaw;
        jaw = most(-c[FRICTION_J], least(c[FRICTION_J], jaw - left / over[SPEED_J][LOAD]));
    }
    for (int i = 0; i < LOAD; i++)
        after.mean[i] += over[i][LOAD] * jaw - over[i][TORQUE_COLUMN] * motor;
    for (int i = 0; i < STATES; i++)
        for (int j = i; j < STATES; j++) {
            double variance = step_var * over[i][STEP_COLUMNS + j];
            variance += c[TORQUE_VAR] * over[i][TORQUE_COLUMN] * over[j][TORQUE_COLUMN];
            for (int m = 0; m < STATES; m++)
                variance += half[i][m] * over[j][m];
            after.covariance[i][j] = after.covariance[j][i] = variance;
        }
    *h = after;
}

static double correct(hypothesis_t *h, double theta, double angle_var)
{
    double innovation = theta - h->mean[ANGLE_M], variance = h->covariance[0][0] + angle_var;
    double row[STATES];
    memcpy(row, h->covariance[0], sizeof row);
    for (int i = 0; i < STATES; i++) {
        double gain = row[i] / variance;
        h->mean[i] += gain * innovation;
        for (int j = 0; j < STATES; j++)
            h->covariance[i][j] -= gain * row[j];
    }
    for (int j = 0; j < STATES; j++)
        h->covariance[0][j] = h->covariance[j][0] = angle_var / variance * row[j];
    return -0.5 * (innovation * innovation / variance + log(variance));
}

static void kalman_read(kalman_t *s, const double *c)
{
    double stepped = s->stepped_weight, quiet = 1.0 - stepped;
    const double *q = s->quiet.mean, *m = s->stepped.mean;
    s->tau_w = quiet * q[LOAD] + stepped * m[LOAD];
    double theta_m = quiet * q[ANGLE_M] + stepped * m[ANGLE_M];
    double theta_j = quiet * q[ANGLE_J] + stepped * m[ANGLE_J];
    s->elongation = c[RADIUS_M] * theta_m - c[RADIUS_J] * theta_j;
}

static void kalman_start(kalman_t *s, const config_t *config, int64_t time_ns, double theta, double torque)
{
    const double *c = config->constants;
    double ratio = c[RADIUS_M] / c[RADIUS_J], load = torque / ratio;
    const double columns[2][STATES] = {{1.0, 0.0, ratio, 0.0, 0.0}, {0.0, 0.0, -c[TURN_PER_LOAD], 0.0, 1.0}};
    const double variances[2] = {c[ANGLE_VAR], c[STEP_VAR]};
    hypothesis_t *h = &s->quiet;
    memset(s, 0, sizeof *s);
    h->mean[ANGLE_M] = theta;
    h->mean[ANGLE_J] = ratio * theta - c[TURN_PER_LOAD] * load;
    h->mean[LOAD] = load;
    for (int k = 0; k < 2; k++)
        for (int i = 0; i < STATES; i++)
            for (int j = 0; j < STATES; j++)
                h->covariance[i][j] += variances[k] * columns[k][i] * columns[k][j];
    h->covariance[SPEED_M][SPEED_M] = h->covariance[SPEED_J][SPEED_J] = 1.0;
    s->stepped = s->quiet;
    s->time_ns = time_ns;
    s->stepped_weight = 0.5;
    kalman_read(s, c);
}

static void kalman_step(kalman_t *s, const config_t *config, int64_t time_ns, double theta, double torque)
{
    const double *c = config->constants;
    double dt = (double)(time_ns - s->time_ns) * 1e-9;
    double steps = -expm1(-c[STEP_RATE] * dt), leaves = -expm1(-c[LEAVE_RATE] * dt);
    double was_stepped = s->stepped_weight, was_quiet = 1.0 - was_stepped;
    double left = was_stepped * leaves, stay = was_stepped - left, calm = was_quiet + left;
    double stepped = stay + calm * steps, quiet = calm * (1.0 - steps);
    double joined = was_quiet * steps / stepped, fresh = calm * steps / stepped;
    hypothesis_t settled, moving;
    mix(&settled, was_quiet / calm, &s->quiet, left / calm, &s->stepped);
    mix(&moving, 1.0 - joined, &s->stepped, joined, &s->quiet);
    double resteps = -expm1(-c[RESTEP_RATE] * dt), drift_var = c[DRIFT] * dt;
    double step_var = c[STEP_VAR] * (fresh + (1.0 - fresh) * resteps);
    predict(&settled, config, torque, drift_var + 0.0);
    predict(&moving, config, torque, drift_var + step_var);
    double settled_log = correct(&settled, theta, c[ANGLE_VAR]);
    double moving_log = correct(&moving, theta, c[ANGLE_VAR]);
    s->stepped_weight = 1.0 / (1.0 + quiet / stepped * exp(settled_log - moving_log));
    s->quiet = settled;
    s->stepped = moving;
    s->time_ns = time_ns;
    kalman_read(s, c);
}

/* -- trajectory, gate --------------------------------------------------------------------------------------------- */

static double trajectory(const config_t *config, double t_s)
{
    int after = 0;
    while (after < config->points && config->times_s[after] <= t_s)
        after++;
    if (after == 0)
        return config->angles_rad[0];
    if (after == config->points)
        return config->angles_rad[after - 1];
    double begin_s = config->times_s[after - 1], begin_rad = config->angles_rad[after - 1];
    double share = (t_s - begin_s) / (config->times_s[after] - begin_s);
    return begin_rad + share * (config->angles_rad[after] - begin_rad);
}

typedef struct {
    int is_open, has_output;
    double position, speed;
    int64_t time_ns;
} gate_t;

static void gate_open(gate_t *gate, const config_t *config, double theta, int64_t now_ns)
{
    int fits = config->low_rad <= theta && theta <= config->high_rad;
    *gate = (gate_t){fits, 0, fits ? theta : 0.0, 0.0, now_ns};
}

static double stoppable_speed(double room, double dt, double acceleration)
{
    return 2.0 * room / (dt + sqrt(dt * dt + 2.0 * room / acceleration));
}

/* Return 1 and the reference that may leave, or 0. */
static int gate_step(gate_t *gate, const config_t *config, double requested, int64_t now_ns, double *passed)
{
    int64_t since_ns = now_ns - gate->time_ns;
    if (!gate->is_open || since_ns < gate->has_output)
        return 0;
    if (since_ns > config->max_gap_ns) {
        gate->is_open = 0;
        return 0;
    }
    if (!isfinite(requested))
        return 0;
    gate->time_ns = now_ns;
    if (!gate->has_output) {
        gate->has_output = 1;
        *passed = gate->position;
        return 1;
    }
    double dt = (double)since_ns * 1e-9, change = config->acceleration_max * dt;
    double position = gate->position, wanted = (requested - position) / dt;
    double ahead = wanted > 0.0 ? config->high_rad - position : position - config->low_rad;
    double stoppable = stoppable_speed(ahead, dt, config->acceleration_max), magnitude = fabs(wanted);
    if (magnitude <= stoppable && magnitude <= config->speed_max && fabs(wanted - gate->speed) <= change) {
        gate->position = *passed = requested;
        gate->speed = wanted;
        return 1;
    }
    double towards = least(least(magnitude, stoppable), config->speed_max);
    towards = least(towards, stoppable_speed(fabs(requested - position), dt, config->acceleration_max));
    double allowed = most(gate->speed - change, least(gate->speed + change, copysign(towards, wanted)));
    gate->position = *passed = most(config->low_rad, least(config->high_rad, position + allowed * dt));
    gate->speed = allowed;
    return 1;
}

/* -- the tick ----------------------------------------------------------------------------------------------------- */

typedef struct {
    int has_feedback, has_sample, is_new;
    uint8_t feedback_sequence, sequence, setpoint_sequence, state;
    int32_t feedback_theta;
    int16_t feedback_current;
    int64_t stamp_ns, theta_raw, received_ns, zero_ns, theta_j_raw, tau_w_raw;
    double theta_rad;
    improved_t improved;
    kalman_t kalman;
    gate_t gate;
} host_t;

/* Take a whole sample; 0 when its stamp is not one period on. */
static int on_sample(host_t *host, const config_t *config, uint32_t stamp_us, uint8_t sequence, int64_t now_ns)
{
    int64_t before_ns = host->stamp_ns;
    host->stamp_ns = (int64_t)stamp_us * 1000;
    if (host->has_sample) {
        host->stamp_ns = before_ns + (int64_t)(uint32_t)(stamp_us - (uint32_t)(before_ns / 1000)) * 1000;
        if (fabs((double)(host->stamp_ns - before_ns) * 1e-9 - config->period_s) >= 1e-10)
            return 0;
    }
    host->theta_raw += (int32_t)((uint32_t)host->feedback_theta - (uint32_t)host->theta_raw);
    host->theta_rad = (double)host->theta_raw * ANGLE_LSB_RAD;
    double torque = host->feedback_current * (config->torque_constant * CURRENT_LSB_A);
    if (config->kind == KALMAN)
        (host->has_sample ? kalman_step : kalman_start)(&host->kalman, config, host->stamp_ns, host->theta_rad, torque);
    else
        (host->has_sample ? improved_step : improved_start)(&host->improved, config, host->stamp_ns, host->theta_rad,
                                                             torque);
    host->has_sample = host->is_new = 1;
    host->sequence = sequence;
    host->received_ns = now_ns;
    if (host->zero_ns < 0 && host->state == OPERATIONAL)
        host->zero_ns = host->stamp_ns;
    return 1;
}

static int receive(host_t *host, const config_t *config, const frame_t *frame, int64_t now_ns)
{
    const uint8_t *data = frame->data;
    if ((frame->id & 31) != config->node || !is_intact(frame))
        return 1;
    switch (frame->id >> 5) {
    case FEEDBACK:
        memcpy(&host->feedback_theta, data, 4);
        memcpy(&host->feedback_current, data + 4, 2);
        host->feedback_sequence = data[6];
        host->has_feedback = 1;
        return 1;
    case TIMING:
        if (!host->has_feedback || host->feedback_sequence != data[4])
            return 1;
        host->has_feedback = 0;
        host->state = data[6] & 15;
        uint32_t stamp_us;
        memcpy(&stamp_us, data, 4);
        return on_sample(host, config, stamp_us, data[4], now_ns);
    case BENCH_SENSOR:
        host->theta_j_raw = int24(data);
        host->tau_w_raw = int24(data + 3);
        return 1;
    default:
        return 1;
    }
}

/* Return 1 and a SETPOINT, or 0 when nothing may leave. */
static int send(host_t *host, const config_t *config, int64_t now_ns, frame_t *out)
{
    double passed, requested = host->theta_rad;
    if (!host->has_sample || !host->is_new || now_ns - host->received_ns > config->max_age_ns)
        return 0;
    host->is_new = 0;
    if (host->state != OPERATIONAL || host->zero_ns < 0) {
        gate_open(&host->gate, config, requested, now_ns);
    } else {
        double elongation = config->kind == KALMAN ? host->kalman.elongation : host->improved.elongation;
        double theta_j = trajectory(config, (double)(host->stamp_ns - host->zero_ns) * 1e-9);
        requested = (config->jaw_radius_m * theta_j + elongation) / config->motor_radius_m;
    }
    if (!gate_step(&host->gate, config, requested, now_ns, &passed))
        return 0;
    int32_t raw = (int32_t)(int64_t)rint(passed / ANGLE_LSB_RAD);
    *out = (frame_t){(uint16_t)(SETPOINT << 5 | config->node), CLASSIC_LENGTH, 0, {0}};
    memcpy(out->data, &raw, 4);
    out->data[4] = ++host->setpoint_sequence;
    out->data[5] = host->sequence;
    out->data[7] = crc8(out->id, out->data, 7);
    return 1;
}

host_t host; /* for all to see, or the compiler would leave out what nobody reads */

/* Run `ticks` ticks: tick i has the frames first[i] .. first[i + 1] - 1, all received by now_ns[i]. `out[i].length` is
 * 0 where no reference left. Return the ticks run: fewer when a sample came over a gap. */
int64_t run(const config_t *config, int64_t ticks, const int64_t *first, const int64_t *now_ns, const frame_t *frames,
            frame_t *out)
{
    make_crc_table();
    memset(&host, 0, sizeof host);
    host.zero_ns = -1;
    for (int64_t i = 0; i < ticks; i++) {
        for (int64_t at = first[i]; at < first[i + 1]; at++)
            if (!receive(&host, config, &frames[at], now_ns[i]))
                return i;
        out[i].length = 0;
        send(&host, config, now_ns[i], &out[i]);
    }
    return ticks;
}
