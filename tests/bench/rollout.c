/* The rollout of hil_forceps/model/closed_loop.py in C: the same equations, the same order of operations. Built and
 * compared by test_rollout.py. Left out: viscous drift (its gains are made anew on the way) and a load that jumps. */
#include <math.h>

enum { FROM_STRETCH, FROM_MOTOR, FROM_JAW, MOTOR_MEAN, MOTOR_SLOPE, JAW_MEAN, JAW_SLOPE };
enum { MOTOR_WAY = 0, MOTOR_SPEED = 7, JAW_WAY = 14, JAW_SPEED = 21, VISCOSITY = 28, STIFFNESS, DAMPING, SIZE };
enum { TAUT, SLACK, SHORT, PIECES = 8, MAX_RING = 256 };
enum { MOVING, STOPPED, STUCK };

typedef struct {
    double r_m, r_j, I_m, I_j, D_m, motor_coulomb, jaw_coulomb, k, K_t, stribeck_rise, stribeck_speed;
    double presliding_level, presliding_angle, load_mu, asymmetry, viscous_change, viscous_time, jaw_slope;
    double jaw_curvature, gravity_sine, gravity_cosine, slack, hardening, loop_force, loop_stretch, creep_share;
    double creep_time, damping, zero_stretch, constant_change, constant_time, cogging_sine, cogging_cosine;
    double cogging_harmonic, ripple_sine, ripple_cosine, ripple_harmonic, current_offset, current_gain, deadband, lag;
    double delay, skew_theta_m, skew_current, skew_theta_j, skew_tau_w, encoder_sine, encoder_cosine, encoder_scale;
    double pulley_sine, pulley_cosine, pitch, limit, play, lever_sine, lever_cosine, coupling_stiffness, coupling_torque;
    double loaded_mu, loaded_angle, viscous_asymmetry, film_level, film_speed, grip_level, grip_mu, grip_angle;
    double jaw_viscous;
} physics;

typedef struct {
    double theta_m, omega_m, theta_j, omega_j, creep, loop, presliding, loaded, gripped, lost, current;
} state;
typedef struct { double theta_m, omega_m, theta_j, omega_j; } motion;
typedef struct { double motor, motor_slope, jaw, jaw_slope; } torques;
typedef struct { double elongation, tension, radius, lever; int slack; } wire_t;
typedef struct { double wire, motor, jaw; } excess;
typedef struct { double current, current_slope, current_end, constant, load, load_slope; } drive;
typedef struct { double speed_of_mean, speed_of_slope, way_of_mean, way_of_slope, speed_of_speed, way_of_speed; } response;
typedef struct { double mean, slope; } line;
typedef struct { double start, end, rest, forward, backward; } levels;
typedef struct { double mean, slope; int fate; } rub;
typedef struct { double mean, slope, end, arrival_mean, arrival_slope, arrival_end; int whole, at; } current_step;

static double low(double a, double b) { return b < a ? b : a; }
static double high(double a, double b) { return b > a ? b : a; }
static double clip(double level, double v) { return high(-level, low(level, v)); }
static double dead_zone(double v, double half) { return v - clip(half, v); }

static double slide(double z, double way, double length) {
    if (way > 0.0) return 1.0 + (z - 1.0) * exp(-way / length);
    if (way < 0.0) return -1.0 + (z + 1.0) * exp(way / length);
    return z;
}

static double lost_after(const physics *p, double lost, double way) {
    return p->play == 0.0 ? 0.0 : clip(p->play, lost + way);
}

static wire_t wire(const physics *p, motion m, double lost, double creep, double loop) {
    double angle = m.theta_m - lost, speed = m.omega_m, paid = p->r_j * m.theta_j;
    if (p->play != 0.0 && lost * m.omega_m < p->play * fabs(m.omega_m)) speed = 0.0;
    wire_t w = { p->r_m * angle, 0.0, p->r_m, p->r_j, 0 };
    if (p->pulley_cosine != 0.0 || p->pulley_sine != 0.0) {
        double s = sin(angle), c = cos(angle);
        w.radius += p->r_m * (p->pulley_cosine * c + p->pulley_sine * s);
        w.elongation += p->r_m * (p->pulley_cosine * s + p->pulley_sine * (1.0 - c));
    }
    if (p->lever_cosine != 0.0 || p->lever_sine != 0.0) {
        double s = sin(m.theta_j), c = cos(m.theta_j);
        w.lever += p->r_j * (p->lever_cosine * c + p->lever_sine * s);
        paid += p->r_j * (p->lever_cosine * s + p->lever_sine * (1.0 - c));
    }
    w.radius += p->pitch * angle / (2.0 * M_PI);
    w.elongation = w.elongation + p->pitch * angle * angle / (4.0 * M_PI) - paid;
    double d = dead_zone(w.elongation - p->zero_stretch - creep, p->slack);
    w.slack = d == 0.0 && p->slack > 0.0;
    w.tension = p->k * d * (1.0 + p->hardening * d * d) + p->loop_force * loop;
    if (!w.slack) w.tension += p->damping * (w.radius * speed - w.lever * m.omega_j);
    return w;
}

static double wave(double sine, double cosine, double harmonic, double angle) {
    if (sine == 0.0 && cosine == 0.0) return 0.0;
    return sine * sin(harmonic * angle) + cosine * cos(harmonic * angle);
}

static double motor_level(const physics *p, double omega, double tension) {
    double level = p->motor_coulomb + p->load_mu * p->r_m * fabs(tension);
    if (p->stribeck_rise != 0.0) {
        double share = omega / p->stribeck_speed;
        level += p->stribeck_rise * exp(-share * share);
    }
    if (p->film_level != 0.0) level += p->film_level * (1.0 - exp(-fabs(omega) / p->film_speed));
    return level;
}

static double rub_of(const physics *p, double presliding, double loaded, double tension) {
    double rub = p->presliding_level * presliding;
    if (p->loaded_mu != 0.0) rub += p->loaded_mu * p->r_m * fabs(tension) * loaded;
    return rub;
}

static double grip_of(const physics *p, double gripped, double tension) {
    return (p->grip_level + p->grip_mu * p->r_j * fabs(tension)) * gripped;
}

static int grips(const physics *p) { return p->grip_level != 0.0 || p->grip_mu != 0.0; }

static double jaw_level(const physics *p, double angle) {
    return high(0.0, p->jaw_coulomb + (p->jaw_slope + p->jaw_curvature * angle) * angle);
}

static double encoder(const physics *p, double angle) {
    return (1.0 + p->encoder_scale) * angle + wave(p->encoder_sine, p->encoder_cosine, 1.0, angle);
}

static line holding(double free_speed, double free_way, response r) {
    double scale = r.way_of_mean * r.speed_of_slope - r.way_of_slope * r.speed_of_mean;
    return (line){ (free_way * r.speed_of_slope - free_speed * r.way_of_slope) / scale,
                   (free_speed * r.way_of_mean - free_way * r.speed_of_mean) / scale };
}

static rub held(double free_speed, double free_way, response r, levels l) {
    line hold = holding(free_speed, free_way, r);
    double mean = hold.mean, slope = hold.slope, last = mean + 0.5 * slope, sign = last > 0.0 ? 1.0 : -1.0;
    double level = l.rest + (last > 0.0 ? l.forward : l.backward);
    double first = sign * (mean - 0.5 * slope), rise = sign * slope;
    if (sign * last > level && level >= first) {
        double rest = 1.0 - (level - first) / rise;
        double over = 0.5 * rise * rest * rest, moment = rise * rest * rest * (0.25 - rest / 6.0);
        return (rub){ mean - sign * over, slope - sign * 12.0 * moment, MOVING };
    }
    level = l.rest + (mean > 0.0 ? l.forward : l.backward);
    if (fabs(mean) <= level) return (rub){ mean, slope, STUCK };
    return (rub){ mean > 0.0 ? level : -level, 0.0, MOVING };
}

/* begin, rise, bend: of the speed with friction `first`; back_bend: with the opposite friction. */
static double turned(double begin, double rise, double bend, double back_bend, double inertia, response r,
                     line hold, double first, double opposite, double *moment) {
    double both = first + opposite, steepness = sqrt(high(0.0, rise * rise - 4.0 * bend * begin));
    double there = low(1.0, 2.0 * begin / (steepness - rise)), rests = there, back = steepness - both / inertia;
    *moment = 0.0;
    if (back > 0.0) {
        rests = back_bend > 0.0 ? low(1.0, there + back / back_bend) : 1.0;
        *moment = -0.5 * both * (rests - there) * (there + rests - 1.0);
        if (rests == 1.0) return (back_bend * (1.0 - there) - back) * (1.0 - there);
    }
    double torque = hold.mean + hold.slope * (rests - 0.5), leaves = rests;
    int forward = torque > first;
    if (-opposite <= torque && torque <= first) {
        forward = hold.slope > 0.0;
        leaves = hold.slope != 0.0 ? low(1.0, 0.5 + ((forward ? first : -opposite) - hold.mean) / hold.slope) : 1.0;
        double square = leaves * leaves - rests * rests, cube = leaves * leaves * leaves - rests * rests * rests;
        double level = hold.mean - 0.5 * hold.slope - first;
        *moment += level * 0.5 * (square - leaves + rests) + hold.slope * (cube / 3.0 - 0.25 * square);
    }
    double after = 1.0 - leaves, square = 1.0 - leaves * leaves, cube = 1.0 - leaves * leaves * leaves;
    double over = hold.mean - 0.5 * hold.slope - (forward ? first : -opposite);
    double speed = r.speed_of_mean * (over * after + 0.5 * hold.slope * square);
    speed += r.speed_of_slope * (6.0 * over * (square - after) + hold.slope * (4.0 * cube - 3.0 * square));
    if (!forward) *moment -= 0.5 * both * after * leaves;
    if (rise < 0.0 && 0.0 < bend && back < 0.0) {
        double share = low(1.0, 4.0 * bend * begin / (rise * rise)) * -back * inertia / both;
        double beyond = high(0.0, 1.0 + 0.5 * rise / bend);
        speed += share * (bend * beyond * beyond - speed);
        *moment *= 1.0 - share;
    }
    return speed;
}

static rub friction(double speed, double free_speed, double free_way, double push, double inertia, response r, levels l) {
    if (speed == 0.0) return held(free_speed, free_way, r, l);
    double sign = speed > 0.0 ? 1.0 : -1.0, extra = speed > 0.0 ? l.forward : l.backward;
    double first = l.start + extra, last = l.end + extra, mean = 0.5 * (first + last), slope = last - first;
    double end = sign * free_speed - r.speed_of_mean * mean - r.speed_of_slope * slope;
    double begin = sign * speed, rise = (sign * push - first) / inertia, bend = end - begin - rise;
    int dips = rise < 0.0 && -rise < 2.0 * bend && rise * rise > 4.0 * bend * begin;
    if (end > 0.0 && !dips) return (rub){ sign * mean, sign * slope, MOVING };
    double opposite = l.rest + (speed > 0.0 ? l.backward : l.forward), moment;
    line hold = holding(free_speed - r.speed_of_speed * speed, free_way - r.way_of_speed * speed, r);
    end = turned(begin, rise, bend, bend + (first + opposite) * (r.speed_of_mean - 1.0 / inertia), inertia,
                 r, (line){ sign * hold.mean, sign * hold.slope }, first, opposite, &moment);
    slope += 12.0 * moment;
    mean = (sign * free_speed - end - r.speed_of_slope * slope) / r.speed_of_mean;
    return (rub){ sign * mean, sign * slope, end == 0.0 ? STOPPED : MOVING };
}

static double answer(const double *g, torques u) {
    return g[MOTOR_MEAN] * u.motor + g[MOTOR_SLOPE] * u.motor_slope + (g[JAW_MEAN] * u.jaw + g[JAW_SLOPE] * u.jaw_slope);
}

static double row(const double *g, double stretch, const state *x, torques u) {
    return g[FROM_STRETCH] * stretch + (g[FROM_MOTOR] * x->omega_m + g[FROM_JAW] * x->omega_j) + answer(g, u);
}

static motion free_motion(const physics *p, const double *g, const state *x, torques u) {
    double stretch = p->r_m * x->theta_m - p->r_j * x->theta_j;
    return (motion){ row(g + MOTOR_WAY, stretch, x, u), row(g + MOTOR_SPEED, stretch, x, u),
                     row(g + JAW_WAY, stretch, x, u), row(g + JAW_SPEED, stretch, x, u) };
}

static motion added(const double *g, motion m, torques u) {
    return (motion){ m.theta_m + answer(g + MOTOR_WAY, u), m.omega_m + answer(g + MOTOR_SPEED, u),
                     m.theta_j + answer(g + JAW_WAY, u), m.omega_j + answer(g + JAW_SPEED, u) };
}

static motion settled(const double *g, const state *x, motion free, const double *push, const double *inertia,
                      levels motor, levels jaw) {
    double guess = x->omega_j == 0.0 ? clip(jaw.rest, push[1]) : x->omega_j > 0.0 ? jaw.start : -jaw.start;
    const double *s = g + MOTOR_SPEED, *w = g + MOTOR_WAY;
    rub m = friction(x->omega_m, free.omega_m - s[JAW_MEAN] * guess, free.theta_m - w[JAW_MEAN] * guess, push[0],
                     inertia[0], (response){ s[MOTOR_MEAN], s[MOTOR_SLOPE], w[MOTOR_MEAN], w[MOTOR_SLOPE], s[FROM_MOTOR], w[FROM_MOTOR] }, motor);
    s = g + JAW_SPEED;
    w = g + JAW_WAY;
    double way = free.theta_j - w[MOTOR_MEAN] * m.mean - w[MOTOR_SLOPE] * m.slope;
    double speed = free.omega_j - s[MOTOR_MEAN] * m.mean - s[MOTOR_SLOPE] * m.slope;
    rub j = friction(x->omega_j, speed, way, push[1], inertia[1],
                     (response){ s[JAW_MEAN], s[JAW_SLOPE], w[JAW_MEAN], w[JAW_SLOPE], s[FROM_JAW], w[FROM_JAW] }, jaw);
    motion end = added(g, free, (torques){ -m.mean, -m.slope, -j.mean, -j.slope });
    return (motion){ x->theta_m + (m.fate == STUCK ? 0.0 : end.theta_m), m.fate >= STOPPED ? 0.0 : end.omega_m,
                     x->theta_j + (j.fate == STUCK ? 0.0 : end.theta_j), j.fate >= STOPPED ? 0.0 : end.omega_j };
}

static int go_on(const state *x, motion end) {
    return x->omega_m * end.omega_m > 0.0 && x->omega_j * end.omega_j > 0.0;
}

/* With more torques, and friction that ends at other levels: linear in both where motor and jaw go on as they went. */
static motion settled_again(const double *g, const state *x, motion free, motion end, torques more, const double *push,
                            const double *inertia, levels motor, levels jaw) {
    double rise = x->omega_m > 0.0 ? motor.end - motor.start : motor.start - motor.end;
    double rise_j = x->omega_j > 0.0 ? jaw.end - jaw.start : jaw.start - jaw.end;
    motion again = added(g, end, (torques){ more.motor - 0.5 * rise, more.motor_slope - rise, more.jaw - 0.5 * rise_j,
                                            more.jaw_slope - rise_j });
    return go_on(x, end) && go_on(x, again) ? again : settled(g, x, added(g, free, more), push, inertia, motor, jaw);
}

static void push_of(const physics *p, const double *g, const state *x, torques u, double *push) {
    double pull = g[STIFFNESS] * (p->r_m * x->theta_m - p->r_j * x->theta_j);
    pull += g[DAMPING] * (p->r_m * x->omega_m - p->r_j * x->omega_j);
    push[0] = u.motor - 0.5 * u.motor_slope - p->r_m * pull - g[VISCOSITY] * x->omega_m;
    push[1] = u.jaw - 0.5 * u.jaw_slope + p->r_j * pull - p->jaw_viscous * x->omega_j;
}

/* What a step can leave out: 2 where nothing but friction's level hangs on the state, 1 where the wire is the linear one. */
static int kind_of(const physics *p) {
    double bent = fabs(p->slack) + fabs(p->hardening) + fabs(p->loop_force) + fabs(p->creep_share) + fabs(p->zero_stretch);
    bent += fabs(p->pulley_sine) + fabs(p->pulley_cosine) + fabs(p->pitch) + fabs(p->play);
    bent += fabs(p->lever_sine) + fabs(p->lever_cosine);
    double pushed = fabs(p->presliding_level) + fabs(p->viscous_change) + fabs(p->loaded_mu) + fabs(p->viscous_asymmetry);
    pushed += fabs(p->cogging_sine) + fabs(p->cogging_cosine) + fabs(p->ripple_sine) + fabs(p->ripple_cosine);
    pushed += fabs(p->gravity_sine) + fabs(p->gravity_cosine) + fabs(p->coupling_stiffness) + fabs(p->coupling_torque);
    pushed += fabs(p->grip_level) + fabs(p->grip_mu);
    return bent != 0.0 ? 0 : pushed != 0.0 ? 1 : 2;
}

static double linear_tension(const physics *p, motion m) {
    return p->k * (p->r_m * m.theta_m - p->r_j * m.theta_j) + p->damping * (p->r_m * m.omega_m - p->r_j * m.omega_j);
}

static wire_t wire_of(const physics *p, int kind, motion m, double lost, double creep, double loop) {
    if (!kind) return wire(p, m, lost, creep, loop);
    return (wire_t){ p->r_m * m.theta_m - p->r_j * m.theta_j, linear_tension(p, m), p->r_m, p->r_j, 0 };
}

static excess excess_of(const physics *p, int kind, const double *g, motion m, wire_t w, const drive *d, double current) {
    double linear = g[STIFFNESS] * (p->r_m * m.theta_m - p->r_j * m.theta_j);
    linear += g[DAMPING] * (p->r_m * m.omega_m - p->r_j * m.omega_j);
    double motor = d->constant * current * wave(p->ripple_sine, p->ripple_cosine, p->ripple_harmonic, m.theta_m);
    motor += wave(p->cogging_sine, p->cogging_cosine, p->cogging_harmonic, m.theta_m);
    motor -= 0.5 * p->viscous_asymmetry * fabs(m.omega_m) + (w.radius - p->r_m) * w.tension;
    double jaw = (w.lever - p->r_j) * w.tension - wave(p->gravity_sine, p->gravity_cosine, 1.0, m.theta_j);
    return (excess){ kind ? 0.0 : w.tension - linear, motor, jaw - (p->coupling_stiffness * m.theta_j + p->coupling_torque) };
}

static void held_back(double change, double way, double by_mean, double by_slope, double *mean, double *slope) {
    double stiffness = way != 0.0 ? change / way : 0.0;
    *mean = 0.5 * change;
    *slope = change;
    if (stiffness > 0.0) {
        double blend = 1.0 / (1.0 + by_mean * stiffness), part = 1.0 - 0.5 * blend;
        change /= 1.0 + (by_mean * part + by_slope * blend) * stiffness;
        *mean = part * change;
        *slope = blend * change;
    }
}

/* ways: of motor and jaw, of the wire; then how much the friction of motor and jaw that builds up over a way changed. */
static torques corrections(const physics *p, int kind, const double *g, const double *ways, excess a, excess b) {
    const double *m = g + MOTOR_WAY, *j = g + JAW_WAY;
    double mm = p->r_m * p->r_m, jj = p->r_j * p->r_j, mj = p->r_m * p->r_j, pull = 0.0, pull_slope = 0.0;
    double rub_ = 0.0, rub_slope = 0.0, grip = 0.0, grip_slope = 0.0;
    if (!kind) {
        double by_mean = mm * m[MOTOR_MEAN] + jj * j[JAW_MEAN] - mj * (m[JAW_MEAN] + j[MOTOR_MEAN]);
        double by_slope = mm * m[MOTOR_SLOPE] + jj * j[JAW_SLOPE] - mj * (m[JAW_SLOPE] + j[MOTOR_SLOPE]);
        held_back(b.wire - a.wire, ways[2], by_mean, by_slope, &pull, &pull_slope);
    }
    if (ways[3] != 0.0) held_back(ways[3], ways[0], m[MOTOR_MEAN], m[MOTOR_SLOPE], &rub_, &rub_slope);
    if (ways[4] != 0.0) held_back(ways[4], ways[1], j[JAW_MEAN], j[JAW_SLOPE], &grip, &grip_slope);
    double motor = b.motor - a.motor, jaw = b.jaw - a.jaw;
    return (torques){ 0.5 * motor - p->r_m * pull - rub_, motor - p->r_m * pull_slope - rub_slope,
                      0.5 * jaw + p->r_j * pull - grip, jaw + p->r_j * pull_slope - grip_slope };
}

static state full_step(const physics *p, int kind, const double *gains, int base, double inertia_m, double inertia_j, double kept,
                       state x, const drive *d) {
    motion now = { x.theta_m, x.omega_m, x.theta_j, x.omega_j };
    double inertia[2] = { inertia_m, inertia_j }, push[2];
    wire_t w0 = wire_of(p, kind, now, x.lost, x.creep, x.loop);
    double rubbed = rub_of(p, x.presliding, x.loaded, w0.tension), holding = grip_of(p, x.gripped, w0.tension);
    const double *g = gains + (base + (w0.slack ? SLACK : TAUT)) * SIZE;
    excess first = excess_of(p, kind, g, now, w0, d, d->current - 0.5 * d->current_slope);
    torques u = { d->constant * d->current + first.motor - rubbed - p->r_m * first.wire,
                  d->constant * d->current_slope, first.jaw + p->r_j * first.wire - d->load - holding, -d->load_slope };
    motion free = free_motion(p, g, &x, u);
    push_of(p, g, &x, u, push);
    double level = motor_level(p, now.omega_m, w0.tension), rest = p->motor_coulomb + p->load_mu * p->r_m * fabs(w0.tension) + p->stribeck_rise;
    double forward = high(0.0, p->asymmetry), backward = high(0.0, -p->asymmetry), level_j = jaw_level(p, now.theta_j);
    motion end = settled(g, &x, free, push, inertia, (levels){ level, level, rest, forward, backward },
                         (levels){ level_j, level_j, level_j, 0.0, 0.0 });
    double creep = kept * x.creep + (1.0 - kept) * p->creep_share * w0.tension / p->k;
    double lost = lost_after(p, x.lost, end.theta_m - now.theta_m);
    wire_t w1 = wire_of(p, kind, end, lost, creep, x.loop);
    if (p->loop_force != 0.0)
        w1 = wire_of(p, kind, end, lost, creep, slide(x.loop, w1.elongation - w0.elongation, p->loop_stretch));
    excess last = excess_of(p, kind, g, end, w1, d, d->current + 0.5 * d->current_slope);
    double way_m = end.theta_m - now.theta_m, way_j = end.theta_j - now.theta_j;
    double slipped = p->presliding_level != 0.0 ? slide(x.presliding, way_m, p->presliding_angle) : 0.0;
    double loaded = p->loaded_mu != 0.0 ? slide(x.loaded, way_m, p->loaded_angle) : 0.0;
    double gripped = grips(p) ? slide(x.gripped, way_j, p->grip_angle) : 0.0;
    double ways[5] = { way_m, way_j, w1.elongation - w0.elongation,
                       rub_of(p, slipped, loaded, w1.tension) - rubbed, grip_of(p, gripped, w1.tension) - holding };
    double last_level = motor_level(p, end.omega_m, w1.tension), last_level_j = jaw_level(p, end.theta_j);
    end = settled_again(g, &x, free, end, corrections(p, kind, g, ways, first, last), push, inertia,
                        (levels){ level, last_level, rest, forward, backward },
                        (levels){ level_j, last_level_j, level_j, 0.0, 0.0 });
    way_m = end.theta_m - x.theta_m;
    state after = { end.theta_m, end.omega_m, end.theta_j, end.omega_j, x.creep, x.loop, x.presliding, x.loaded, x.gripped,
                    lost_after(p, x.lost, way_m), d->current_end };
    if (p->creep_share != 0.0)
        after.creep = kept * x.creep + (1.0 - kept) * p->creep_share * 0.5 * (w0.tension + w1.tension) / p->k;
    if (p->presliding_level != 0.0) after.presliding = slide(x.presliding, way_m, p->presliding_angle);
    if (p->loaded_mu != 0.0) after.loaded = slide(x.loaded, way_m, p->loaded_angle);
    if (grips(p)) after.gripped = slide(x.gripped, end.theta_j - x.theta_j, p->grip_angle);
    if (p->loop_force != 0.0)
        after.loop = slide(x.loop, wire_of(p, kind, end, after.lost, after.creep, x.loop).elongation - w0.elongation, p->loop_stretch);
    return after;
}

/* The state at the end of a step that leaves nothing in wire or friction. */
static state nothing_else(state x, motion end, double current) {
    return (state){ end.theta_m, end.omega_m, end.theta_j, end.omega_j, x.creep, x.loop, x.presliding, x.loaded, x.gripped,
                    x.lost, current };
}

/* Where nothing but friction's level hangs on the state. */
static state level_step(const physics *p, const double *g, double inertia_m, double inertia_j, state x, const drive *d) {
    motion now = { x.theta_m, x.omega_m, x.theta_j, x.omega_j };
    double inertia[2] = { inertia_m, inertia_j }, push[2], tension = linear_tension(p, now);
    torques u = { d->constant * d->current, d->constant * d->current_slope, -d->load, -d->load_slope };
    motion free = free_motion(p, g, &x, u);
    push_of(p, g, &x, u, push);
    double level = motor_level(p, now.omega_m, tension), rest = p->motor_coulomb + p->load_mu * p->r_m * fabs(tension) + p->stribeck_rise;
    double forward = high(0.0, p->asymmetry), backward = high(0.0, -p->asymmetry), level_j = jaw_level(p, now.theta_j);
    motion end = settled(g, &x, free, push, inertia, (levels){ level, level, rest, forward, backward },
                         (levels){ level_j, level_j, level_j, 0.0, 0.0 });
    double last_level = motor_level(p, end.omega_m, linear_tension(p, end)), last_level_j = jaw_level(p, end.theta_j);
    if (last_level != level || last_level_j != level_j)
        end = settled_again(g, &x, free, end, (torques){ 0.0, 0.0, 0.0, 0.0 }, push, inertia,
                            (levels){ level, last_level, rest, forward, backward },
                            (levels){ level_j, last_level_j, level_j, 0.0, 0.0 });
    return nothing_else(x, end, d->current_end);
}

static state plain_step(const physics *p, const double *g, const double *inertia, state x, const drive *d) {
    levels motor = { p->motor_coulomb, p->motor_coulomb, p->motor_coulomb, high(0.0, p->asymmetry), high(0.0, -p->asymmetry) };
    levels jaw = { p->jaw_coulomb, p->jaw_coulomb, p->jaw_coulomb, 0.0, 0.0 };
    torques u = { d->constant * d->current, d->constant * d->current_slope, -d->load, -d->load_slope };
    double push[2];
    motion free = free_motion(p, g, &x, u);
    push_of(p, g, &x, u, push);
    return nothing_else(x, settled(g, &x, free, push, inertia, motor, jaw), d->current_end);
}

static int uneven(double change, double over, double reach, double inertia, double first, double last) {
    if (low(fabs(first), fabs(last)) >= reach * over || (first == 0.0 && last == 0.0)) return 0;
    return first * last <= 0.0 || fabs(last - first) > 0.2 * over || fabs(change) > 0.1 * inertia * over;
}

static int sudden(const physics *p, int kind, double inertia, const state *x, const state *end) {
    if (p->play > 0.0 && (fabs(x->lost) < p->play || fabs(end->lost) < p->play)) return 1;
    if (p->slack > 0.0) {
        wire_t a = wire_of(p, kind, (motion){ x->theta_m, 0.0, x->theta_j, 0.0 }, x->lost, x->creep, x->loop);
        wire_t b = wire_of(p, kind, (motion){ end->theta_m, 0.0, end->theta_j, 0.0 }, end->lost, end->creep, end->loop);
        if (a.slack != b.slack || a.tension * b.tension < 0.0) return 1;
    }
    double first = x->omega_m, last = end->omega_m;
    if (p->stribeck_rise != 0.0 && uneven(p->stribeck_rise, p->stribeck_speed, 3.0, inertia, first, last)) return 1;
    if (p->film_level == 0.0) return 0;
    double over = 2.0 * p->film_level / p->film_speed / inertia;
    if (low(fabs(first), fabs(last)) >= high(0.3, over - 1.0) * p->film_speed) return 0;
    double stiff = log(high(1.0, over));
    return uneven(p->film_level, p->film_speed, high(0.3, stiff), inertia, first, last);
}

static state one_step(const physics *p, int kind, const double *g, int base, double inertia_m, double inertia_j, double kept,
                      state x, const drive *d) {
    return kind == 2 ? level_step(p, g + (base + TAUT) * SIZE, inertia_m, inertia_j, x, d)
                     : full_step(p, kind, g, base, inertia_m, inertia_j, kept, x, d);
}

static state refined_step(const physics *p, int kind, const double *g, const double *inertia, const double *kept, state x,
                          const drive *d) {
    state end = one_step(p, kind, g, TAUT, inertia[0], inertia[1], kept[0], x, d);
    if (!sudden(p, kind, inertia[0], &x, &end)) return end;
    for (int piece = 0; piece < PIECES; piece++) {
        double at = (piece + 0.5) / PIECES - 0.5;
        drive part = { d->current + at * d->current_slope, d->current_slope / PIECES, d->current_end, d->constant,
                       d->load + at * d->load_slope, d->load_slope / PIECES };
        x = one_step(p, kind, g, SHORT, inertia[0] * PIECES, inertia[1] * PIECES, kept[1], x, &part);
    }
    return x;
}

/* law: T, kp, ki, kd, share, limit, error first; start: plant (11), integral, last angle, velocity, current. */
void rollout(const double *physics_, const double *law, double quantum, double row_s, int rows, const double *reference,
             const double *load, const double *start, int substeps, int samples, const double *gains,
             const current_step *c, int full, double *out) {
    physics p = *(const physics *)physics_;
    state x = *(const state *)start;
    double integral = start[11], angle_before = start[12], velocity = start[13], ring[MAX_RING];
    int kind = kind_of(&p), steps = substeps / samples, place = 0, places = c->whole + 2;
    double step_s = row_s / substeps, inertia[2] = { p.I_m / step_s, p.I_j / step_s };
    double kept[2] = { exp(-step_s / p.creep_time), exp(-step_s / PIECES / p.creep_time) };
    for (int i = 0; i < places; i++) ring[i] = x.current;
    for (int n = 0; n < rows; n++) {
        wire_t w = wire(&p, (motion){ x.theta_m, x.omega_m, x.theta_j, x.omega_j }, x.lost, x.creep, x.loop);
        double shown[8] = { encoder(&p, x.theta_m), x.current, x.theta_j, load[n], w.tension, w.elongation, x.omega_m, x.omega_j };
        for (int i = 0; i < 8; i++) out[i * rows + n] = shown[i];
        if (n == rows - 1) break;
        for (int step = 0; step < substeps; step++) {
            int into = step % steps;
            if (into == 0) {
                double angle = encoder(&p, x.theta_m);
                if (quantum > 0.0) angle = floor(angle / quantum + 0.5) * quantum;
                double error = reference[n] - angle, old = integral;
                integral += error * law[0];
                if (law[2] > 0.0) integral = clip(law[5] / law[2], integral);
                if (!isnan(angle_before)) velocity += law[4] * ((angle - angle_before) / law[0] - velocity);
                angle_before = angle;
                double command = law[1] * error + law[2] * (law[6] != 0.0 ? integral : old) - law[3] * velocity;
                place = place + 1 < places ? place + 1 : 0;
                ring[place] = clip(p.limit, dead_zone(clip(law[5], command), p.deadband));
            }
            int a = place - c->whole - 1, b = place - c->whole;
            double before = ring[a >= 0 ? a : a + places], now = ring[b >= 0 ? b : b + places];
            double u = into <= c->at ? before : now, arriving = into == c->at ? now - before : 0.0, away = x.current - u;
            double rise = (load[n + 1] - load[n]) / substeps, constant = p.K_t;
            if (p.constant_change != 0.0)
                constant *= 1.0 + p.constant_change * (1.0 - exp(-(n * substeps + step + 0.5) * step_s / p.constant_time));
            drive d = { u + away * c->mean + arriving * c->arrival_mean, away * c->slope + arriving * c->arrival_slope,
                        u + away * c->end + arriving * c->arrival_end, constant, load[n] + rise * (step + 0.5), rise };
            x = full ? refined_step(&p, kind, gains, inertia, kept, x, &d) : plain_step(&p, gains, inertia, x, &d);
        }
    }
}
