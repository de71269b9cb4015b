/*
 * The reference firmware as a POSIX process. It says one line, `ready ...`, when it listens, and one line of JSON at its
 * end, on standard output (standard error with --stdio). SIGINT and SIGTERM end it; SIGUSR1 is an overcurrent.
 */
#include "host.h"
#include "options.h"

#include <errno.h>
#include <math.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

enum { NS_PER_US = 1000, NS_PER_S = 1000000000, MAX_WAIT_NS = 500000, MIN_PERIOD_NS = 10000, MAX_LATE_PERIODS = 10, LOCKSTEP_WAIT_MS = 50 };

static const float CURRENT_LSB_A = 2.0e-4F;

typedef struct {
    options chosen;
    hfp_node node;
    host_link link;
    test_plant motor;
    lockstep plant;
    int64_t start_ns;
    int64_t period_ns;
    float current_A; /* held since the last sample */
    uint8_t taken; /* frames, modulo 256 */
    uint8_t sent;
    uint64_t late; /* samples skipped because the process was not woken */
} host;

static volatile sig_atomic_t stop_asked;
static volatile sig_atomic_t overcurrent;

static void on_signal(int number)
{
    if (number == SIGUSR1) {
        overcurrent = 1;
    } else {
        stop_asked = 1;
    }
}

static int64_t clock_ns(void)
{
    struct timespec now;

    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * NS_PER_S + now.tv_nsec;
}

static bool port_receive(void *context, hfp_frame *frame)
{
    host *self = context;
    bool taken = link_receive(&self->link, frame);

    self->taken = (uint8_t)(self->taken + taken);
    return taken;
}

static bool port_send(void *context, const hfp_frame *frame)
{
    host *self = context;
    bool sent = link_send(&self->link, frame);

    self->sent = (uint8_t)(self->sent + sent);
    return sent;
}

static uint32_t port_now_us(void *context)
{
    const host *self = context;

    if (self->chosen.plant != NULL) {
        return self->plant.reading.stamp_us;
    }
    return (uint32_t)((clock_ns() - self->start_ns) / NS_PER_US);
}

static void port_measure(void *context, hfp_reading *reading)
{
    host *self = context;

    if (self->chosen.plant != NULL) {
        *reading = self->plant.reading;
        return;
    }
    test_plant_move(&self->motor, (double)self->current_A, (double)self->period_ns / NS_PER_S);
    reading->stamp_us = port_now_us(context);
    reading->theta_m_raw = test_plant_theta_raw(&self->motor);
    reading->current_raw = (int32_t)lroundf(self->current_A / CURRENT_LSB_A);
}

static hfp_fault port_protection(void *context)
{
    bool was = overcurrent != 0;

    (void)context;
    overcurrent = 0;
    return was ? HFP_FAULT_OVERCURRENT : HFP_FAULT_NONE;
}

static void port_set_current(void *context, float current_A)
{
    ((host *)context)->current_A = current_A;
}

static void port_keep_node(void *context, uint8_t node)
{
    (void)context; /* a process forgets: it starts with the node of its command line */
    (void)node;
}

static const hfp_port PORT = {
    port_receive, port_send, port_now_us, port_measure, port_protection, port_set_current, port_keep_node};

/* A frame that never comes holds the plant up no longer than LOCKSTEP_WAIT_MS. */
static void take_frames(host *self)
{
    struct pollfd waiting = {.fd = self->link.in, .events = POLLIN, .revents = 0};

    do {
        hfp_node_service(&self->node);
    } while (!self->link.ended && lockstep_misses(&self->plant, self->taken) && poll(&waiting, 1, LOCKSTEP_WAIT_MS) > 0);
}

static void run_lockstep(host *self)
{
    while (!stop_asked && !self->link.ended) {
        if (lockstep_wait(&self->plant, LOCKSTEP_WAIT_MS)) {
            take_frames(self);
            if (lockstep_samples(&self->plant)) {
                hfp_node_sample(&self->node);
            }
            lockstep_answer(&self->plant, &self->node, self->current_A, self->sent);
        }
    }
}

static void run_real_time(host *self)
{
    int64_t next_ns = self->start_ns;
    int64_t end_ns = self->start_ns + (int64_t)(self->chosen.duration_s * NS_PER_S);
    struct pollfd waiting = {.fd = self->link.in, .events = POLLIN, .revents = 0};

    while (!stop_asked && !self->link.ended && (end_ns == self->start_ns || clock_ns() < end_ns)) {
        int64_t now_ns = clock_ns();
        if (now_ns >= next_ns) {
            hfp_node_sample(&self->node);
            next_ns += self->period_ns;
            if (now_ns - next_ns > MAX_LATE_PERIODS * self->period_ns) {
                self->late += (uint64_t)((now_ns - next_ns) / self->period_ns);
                next_ns = now_ns;
            }
            continue;
        }
        int64_t wait_ns = next_ns - now_ns < MAX_WAIT_NS ? next_ns - now_ns : MAX_WAIT_NS;
        const struct timespec timeout = {.tv_sec = 0, .tv_nsec = (long)wait_ns};
        (void)ppoll(&waiting, 1, &timeout, NULL);
        hfp_node_service(&self->node);
    }
}

static void say(const host *self, FILE *to)
{
    static const char *const NAMES[HFP_COUNTERS] = {
        "unknown_id",   "bad_length",      "bad_format",   "bad_crc",        "not_enabled",
        "setpoint_stale", "sample_old",    "sample_future", "heartbeat_stale", "param_refused",
        "assign_refused", "not_for_us",    "setpoints_accepted", "setpoints_lost", "faults"};

    (void)fprintf(to, "{\"state\": %u, \"fault\": %u, \"unsent\": %llu, \"late\": %llu", self->node.drive.state,
                  self->node.drive.fault, (unsigned long long)self->node.unsent, (unsigned long long)self->late);
    for (unsigned i = 0; i < HFP_COUNTERS; i++) {
        (void)fprintf(to, ", \"%s\": %llu", NAMES[i], (unsigned long long)self->node.drive.counters[i]);
    }
    (void)fputs("}\n", to);
    (void)fflush(to);
}

static bool open_link(host *self, char *where, size_t size)
{
    const options *chosen = &self->chosen;

    if (chosen->pty != NULL) {
        return link_open_pty(&self->link, chosen->pty, where, size);
    }
    if (chosen->can != NULL) {
        return link_open_can(&self->link, chosen->can, where, size);
    }
    return chosen->udp != NULL ? link_open_udp(&self->link, chosen->udp, where, size)
                               : link_open_stdio(&self->link, where, size);
}

static bool start(host *self, FILE *to)
{
    char where[256];
    char plant[80] = "";
    struct sockaddr_in bound;

    if (!open_link(self, where, sizeof where)) {
        (void)fprintf(stderr, "can't open the link: %s\n", strerror(errno));
        return false;
    }
    if (self->chosen.plant != NULL) {
        self->plant.socket = udp_bind(self->chosen.plant, &bound);
        if (self->plant.socket < 0) {
            (void)fprintf(stderr, "--plant: %s\n", strerror(errno));
            return false;
        }
        (void)snprintf(plant, sizeof plant, " plant %u", (unsigned)ntohs(bound.sin_port));
    }
    self->start_ns = clock_ns();
    self->period_ns = (int64_t)llround((double)self->chosen.loop.sample_time_s * NS_PER_S);
    if (self->period_ns < MIN_PERIOD_NS) {
        (void)fputs("--sample_time_s: no process is that fast\n", stderr);
        return false;
    }
    if (!hfp_node_init(&self->node, &self->chosen.config, &self->chosen.loop, self->chosen.feedback_divider, &PORT, self)) {
        (void)fputs("a setting is out of its bounds\n", stderr);
        return false;
    }
    (void)fprintf(to, "ready %s node %u period_us %lld%s\n", where, self->node.drive.node,
                  (long long)(self->period_ns / NS_PER_US), plant);
    (void)fflush(to);
    return true;
}

int main(int count, char **arguments)
{
    static host self; /* here only: a process has one drive */
    struct sigaction action;
    FILE *to;

    if (!options_parse(&self.chosen, count, arguments)) {
        return 2;
    }
    to = self.chosen.stdio ? stderr : stdout;
    memset(&action, 0, sizeof action);
    action.sa_handler = on_signal;
    (void)sigaction(SIGINT, &action, NULL);
    (void)sigaction(SIGTERM, &action, NULL);
    (void)sigaction(SIGUSR1, &action, NULL);
    (void)signal(SIGPIPE, SIG_IGN);
    if (!start(&self, to)) {
        return 2;
    }
    if (self.chosen.plant != NULL) {
        run_lockstep(&self);
    } else {
        run_real_time(&self);
    }
    link_close(&self.link, self.chosen.pty);
    say(&self, to);
    return 0;
}
