/* The command line: every setting of drive and loop by its name in the rig or in the parameter dictionary. */
#include "options.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef enum { TEXT, FLAG, INT32, BYTE, HALF, SERIAL, REAL, SECONDS } kind;

typedef struct {
    const char *name;
    kind what;
    size_t offset;
} option;

#define AT(member) offsetof(options, member)

static const option OPTIONS[] = {
    {"serial-pty", TEXT, AT(pty)},
    {"udp", TEXT, AT(udp)},
    {"can", TEXT, AT(can)},
    {"stdio", FLAG, AT(stdio)},
    {"plant", TEXT, AT(plant)},
    {"duration", SECONDS, AT(duration_s)},
    {"feedback_divider", HALF, AT(feedback_divider)},
    {"node", BYTE, AT(config.node)},
    {"serial_number", SERIAL, AT(config.serial_number)},
    {"fd", FLAG, AT(config.fd)},
    {"theta_min_raw", INT32, AT(config.theta_min_raw)},
    {"theta_max_raw", INT32, AT(config.theta_max_raw)},
    {"max_step_raw", INT32, AT(config.max_step_raw)},
    {"reference_tolerance_raw", INT32, AT(config.reference_tolerance_raw)},
    {"watchdog_timeout_us", INT32, AT(config.watchdog_timeout_us)},
    {"host_heartbeat_timeout_us", INT32, AT(config.host_heartbeat_timeout_us)},
    {"heartbeat_period_us", INT32, AT(config.heartbeat_period_us)},
    {"arm_timeout_us", INT32, AT(config.arm_timeout_us)},
    {"max_sample_age", INT32, AT(config.max_sample_age)},
    {"sample_period_us", INT32, AT(config.sample_period_us)},
    {"counts_per_rev", INT32, AT(config.counts_per_rev)},
    {"torque_constant_nN_m_per_A", INT32, AT(config.torque_constant_nN_m_per_A)},
    {"sample_time_s", REAL, AT(loop.sample_time_s)},
    {"kp_A_per_rad", REAL, AT(loop.kp_A_per_rad)},
    {"ki_A_per_rad_s", REAL, AT(loop.ki_A_per_rad_s)},
    {"kd_A_s_per_rad", REAL, AT(loop.kd_A_s_per_rad)},
    {"derivative_cutoff_Hz", REAL, AT(loop.derivative_cutoff_Hz)},
    {"current_limit_A", REAL, AT(loop.current_limit_A)},
    {"cascade_time_s", REAL, AT(loop.cascade_time_s)},
};

enum { OPTION_COUNT = sizeof OPTIONS / sizeof OPTIONS[0] };

static void help(void)
{
    (void)fputs("hfp-drive: the reference firmware as a process\n"
                "  --serial-pty LINK | --udp ADDRESS:PORT | --can DEVICE | --stdio   where it speaks (UDP: one packet a datagram)\n"
                "  --plant ADDRESS:PORT   a plant outside is its clock (lockstep.c); without: a test plant, real time\n"
                "  --duration S           end after so long\n"
                "settings, each with its value:\n",
                stderr);
    for (unsigned i = 0; i < OPTION_COUNT; i++) {
        if (OPTIONS[i].what >= INT32 && OPTIONS[i].what != SECONDS) {
            (void)fprintf(stderr, "  --%s", OPTIONS[i].name);
        }
    }
    (void)fputs("\n  --fd\n", stderr);
}

static const option *find(const char *argument)
{
    if (strncmp(argument, "--", 2) == 0) {
        for (unsigned i = 0; i < OPTION_COUNT; i++) {
            if (strcmp(OPTIONS[i].name, argument + 2) == 0) {
                return &OPTIONS[i];
            }
        }
    }
    return NULL;
}

static bool read_integer(const char *text, long long least, long long most, long long *value)
{
    char *end;

    errno = 0;
    *value = strtoll(text, &end, 0);
    return errno == 0 && end != text && *end == '\0' && *value >= least && *value <= most;
}

static bool read_real(const char *text, double *value)
{
    char *end;

    *value = strtod(text, &end);
    return end != text && *end == '\0' && *value >= 0.0 && *value < 1.0e9;
}

static bool store(void *place, kind what, const char *text)
{
    long long whole = 0;
    double real = 0.0;

    switch (what) {
    case TEXT:
        *(const char **)place = text;
        return true;
    case INT32:
        if (!read_integer(text, INT32_MIN, INT32_MAX, &whole)) {
            return false;
        }
        *(int32_t *)place = (int32_t)whole;
        return true;
    case BYTE:
        if (!read_integer(text, 0, UINT8_MAX, &whole)) {
            return false;
        }
        *(uint8_t *)place = (uint8_t)whole;
        return true;
    case HALF:
        if (!read_integer(text, 0, UINT16_MAX, &whole)) {
            return false;
        }
        *(uint16_t *)place = (uint16_t)whole;
        return true;
    case SERIAL:
        if (!read_integer(text, 0, INT64_MAX, &whole)) {
            return false;
        }
        *(uint64_t *)place = (uint64_t)whole;
        return true;
    case REAL:
    case SECONDS:
        if (!read_real(text, &real)) {
            return false;
        }
        if (what == REAL) {
            *(float *)place = (float)real;
        } else {
            *(double *)place = real;
        }
        return true;
    default:
        return false;
    }
}

static void set_defaults(options *chosen)
{
    memset(chosen, 0, sizeof *chosen);
    chosen->config = hfp_config_default(1, 0xC0DE00000001);
    chosen->feedback_divider = 1;
    chosen->loop = (hfp_loop_config){1.0e-3F, 1.2F, 15.0F, 6.0e-3F, 150.0F, 1.0F, 0.0F};
}

bool options_parse(options *chosen, int count, char **arguments)
{
    set_defaults(chosen);
    for (int i = 1; i < count; i++) {
        const option *row = find(arguments[i]);
        if (row == NULL) {
            if (strcmp(arguments[i], "--help") != 0) {
                (void)fprintf(stderr, "%s: no such option\n", arguments[i]);
            }
            help();
            return false;
        }
        void *place = (char *)chosen + row->offset;
        if (row->what == FLAG) {
            *(bool *)place = true;
        } else if (++i >= count || !store(place, row->what, arguments[i])) {
            (void)fprintf(stderr, "--%s: wants a value that fits\n", row->name);
            return false;
        }
    }
    if ((chosen->pty != NULL) + (chosen->udp != NULL) + (chosen->can != NULL) + chosen->stdio != 1) {
        (void)fputs("one of --serial-pty, --udp, --can and --stdio is wanted\n", stderr);
        return false;
    }
    return true;
}
