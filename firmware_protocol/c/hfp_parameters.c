/* The parameter dictionary: indices, access and bounds (HFP-150 to HFP-159). */
#include "hfp_private.h"

enum { SERIAL_HALF_BITS = 24, SERIAL_BITS = 48, SERIAL_HALF_MAX = 0xFFFFFF };

typedef struct {
    uint16_t index;
    bool writable; /* while DISABLED */
    int32_t minimum;
    int32_t maximum;
} parameter;

static const parameter DICTIONARY[HFP_ROWS] = {
    [HFP_ROW_PROTOCOL_MAJOR] = {0x0001, false, 0, 255},
    [HFP_ROW_PROTOCOL_MINOR] = {0x0002, false, 0, 255},
    [HFP_ROW_NODE] = {0x0003, false, 1, HFP_MAX_NODE},
    [HFP_ROW_SERIAL_LOW] = {0x0004, false, 0, SERIAL_HALF_MAX},
    [HFP_ROW_SERIAL_HIGH] = {0x0005, false, 0, SERIAL_HALF_MAX},
    [HFP_ROW_FD] = {0x0006, false, 0, 1},
    [HFP_ROW_THETA_MIN] = {0x0101, true, INT32_MIN, INT32_MAX},
    [HFP_ROW_THETA_MAX] = {0x0102, true, INT32_MIN, INT32_MAX},
    [HFP_ROW_MAX_STEP] = {0x0103, true, 1, 16777216},
    [HFP_ROW_REFERENCE_TOLERANCE] = {0x0104, true, 0, 1048576},
    [HFP_ROW_WATCHDOG_TIMEOUT] = {0x0201, true, 1000, 500000},
    [HFP_ROW_HOST_HEARTBEAT_TIMEOUT] = {0x0202, true, 5000, 2000000},
    [HFP_ROW_HEARTBEAT_PERIOD] = {0x0203, true, 5000, 1000000},
    [HFP_ROW_ARM_TIMEOUT] = {0x0204, true, 1000, 10000000},
    [HFP_ROW_MAX_SAMPLE_AGE] = {0x0205, true, 0, 127},
    [HFP_ROW_SAMPLE_PERIOD] = {0x0206, false, 1, 1000000},
    [HFP_ROW_COUNTS_PER_REV] = {0x0301, false, 1, 16777216},
    [HFP_ROW_TORQUE_CONSTANT] = {0x0302, false, 1, INT32_MAX},
    [HFP_ROW_REJECTED] = {0x0401, false, 0, INT32_MAX},
    [HFP_ROW_SETPOINTS_ACCEPTED] = {0x0402, false, 0, INT32_MAX},
    [HFP_ROW_SETPOINTS_LOST] = {0x0403, false, 0, INT32_MAX},
};

static bool is_within(hfp_row row, int32_t value)
{
    return value >= DICTIONARY[row].minimum && value <= DICTIONARY[row].maximum;
}

hfp_config hfp_config_default(uint8_t node, uint64_t serial_number)
{
    const hfp_config config = {
        .serial_number = serial_number,
        .node = node,
        .fd = false,
        .theta_min_raw = INT32_MIN,
        .theta_max_raw = INT32_MAX,
        .max_step_raw = 1 << 18,
        .reference_tolerance_raw = 1 << 14,
        .watchdog_timeout_us = 20000,
        .host_heartbeat_timeout_us = 100000,
        .heartbeat_period_us = 100000,
        .arm_timeout_us = 1000000,
        .max_sample_age = 20,
        .sample_period_us = 1000,
        .counts_per_rev = 1 << 24,
        .torque_constant_nN_m_per_A = 13500000,
    };
    return config;
}

bool hfp_parameters_init(int32_t values[HFP_ROWS], const hfp_config *config)
{
    values[HFP_ROW_PROTOCOL_MAJOR] = HFP_PROTOCOL_MAJOR;
    values[HFP_ROW_PROTOCOL_MINOR] = HFP_PROTOCOL_MINOR;
    values[HFP_ROW_NODE] = config->node;
    values[HFP_ROW_SERIAL_LOW] = (int32_t)config->serial_number & SERIAL_HALF_MAX;
    values[HFP_ROW_SERIAL_HIGH] = (int32_t)(config->serial_number >> SERIAL_HALF_BITS) & SERIAL_HALF_MAX;
    values[HFP_ROW_FD] = config->fd;
    values[HFP_ROW_THETA_MIN] = config->theta_min_raw;
    values[HFP_ROW_THETA_MAX] = config->theta_max_raw;
    values[HFP_ROW_MAX_STEP] = config->max_step_raw;
    values[HFP_ROW_REFERENCE_TOLERANCE] = config->reference_tolerance_raw;
    values[HFP_ROW_WATCHDOG_TIMEOUT] = config->watchdog_timeout_us;
    values[HFP_ROW_HOST_HEARTBEAT_TIMEOUT] = config->host_heartbeat_timeout_us;
    values[HFP_ROW_HEARTBEAT_PERIOD] = config->heartbeat_period_us;
    values[HFP_ROW_ARM_TIMEOUT] = config->arm_timeout_us;
    values[HFP_ROW_MAX_SAMPLE_AGE] = config->max_sample_age;
    values[HFP_ROW_SAMPLE_PERIOD] = config->sample_period_us;
    values[HFP_ROW_COUNTS_PER_REV] = config->counts_per_rev;
    values[HFP_ROW_TORQUE_CONSTANT] = config->torque_constant_nN_m_per_A;
    for (hfp_row row = 0; row < HFP_ROWS; row++) {
        if (!is_within(row, values[row])) {
            return false;
        }
    }
    return config->serial_number >> SERIAL_BITS == 0 && config->theta_min_raw <= config->theta_max_raw;
}

static hfp_row row_of(uint16_t index)
{
    hfp_row row = 0;

    while (row < HFP_ROWS && DICTIONARY[row].index != index) {
        row++;
    }
    return row;
}

/* Tell whether the lower position limit would pass the upper one. */
static bool crosses_limits(const int32_t values[HFP_ROWS], hfp_row row, int32_t value)
{
    if (row == HFP_ROW_THETA_MIN) {
        return value > values[HFP_ROW_THETA_MAX];
    }
    return row == HFP_ROW_THETA_MAX && value < values[HFP_ROW_THETA_MIN];
}

/* The order is that of HFP-157. */
static uint8_t judge_write(const int32_t values[HFP_ROWS], hfp_row row, int32_t value, bool disabled)
{
    if (!DICTIONARY[row].writable) {
        return HFP_OP_READ_ONLY;
    }
    if (!disabled) {
        return HFP_OP_WRONG_STATE;
    }
    if (!is_within(row, value) || crosses_limits(values, row, value)) {
        return HFP_OP_OUT_OF_RANGE;
    }
    return HFP_OP_OK;
}

uint8_t hfp_parameters_execute(
    int32_t values[HFP_ROWS], uint8_t op, uint16_t index, int32_t value, bool disabled, int32_t *held)
{
    hfp_row row = row_of(index);
    uint8_t result = HFP_OP_OK;

    *held = 0;
    if (op != HFP_OP_READ && op != HFP_OP_WRITE) {
        result = HFP_OP_UNKNOWN_OP;
    } else if (row == HFP_ROWS) {
        result = HFP_OP_UNKNOWN_INDEX;
    } else if (op == HFP_OP_WRITE) {
        result = judge_write(values, row, value, disabled);
    }
    if (row < HFP_ROWS) {
        if (op == HFP_OP_WRITE && result == HFP_OP_OK) {
            values[row] = value;
        }
        *held = values[row];
    }
    return result;
}
