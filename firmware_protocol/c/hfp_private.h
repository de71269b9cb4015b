/* What the sources share among themselves. */
#ifndef HFP_PRIVATE_H
#define HFP_PRIVATE_H

#include "hfp.h"

enum { HFP_CRC16_INIT = 0xFFFF };

hfp_function hfp_function_of(uint16_t id);
uint8_t hfp_node_of(uint16_t id);

static inline uint16_t hfp_load16(const uint8_t *data)
{
    return (uint16_t)(data[0] | data[1] << 8);
}

static inline void hfp_store16(uint8_t *data, uint16_t value)
{
    data[0] = (uint8_t)value;
    data[1] = (uint8_t)(value >> 8);
}

enum { HFP_MAX_ADVANCE = 127 }; /* sequence numbers ahead that count as new; what is further ahead is taken for old */

/* What can happen to a drive. */
typedef enum {
    ON_ENABLE, /* rising edge of ENABLE from a host whose version fits */
    ON_VERSION_MISFIT,
    ON_DISABLE, /* ENABLE low */
    ON_RESET, /* rising edge of FAULT_RESET */
    ON_REFERENCE, /* fresh, within limits; in ARMED also within tolerance of the measured angle */
    ON_REFERENCE_OFF, /* fresh, but in ARMED too far from the measured angle */
    ON_REFERENCE_OUTSIDE,
    ON_REFERENCE_JUMP,
    ON_WATCHDOG_EXPIRED,
    ON_HOST_LOST,
    ON_ARM_EXPIRED,
    ON_ESTOP,
    ON_TRIP, /* the device's own protection */
    EVENTS
} hfp_event;

/* A SETPOINT or FD_SETPOINT. */
typedef struct {
    int32_t raw;
    uint8_t sequence;
    uint8_t sample_sequence;
} hfp_reference;

/* Let an event happen: what is not in the table changes nothing. The second is for a fault with a reason of its own. */
void hfp_fire(hfp_drive *drive, hfp_event what);
void hfp_fire_for(hfp_drive *drive, hfp_event what, uint8_t reason);

bool hfp_has_passed(uint32_t since_us, uint32_t now_us, int32_t timeout_us);
void hfp_expire(hfp_drive *drive, uint32_t now_us);
void hfp_forget_host(hfp_drive *drive);
void hfp_take_reference(hfp_drive *drive, const hfp_reference *reference, uint32_t now_us, int32_t theta_m_raw);

/* Count why something was dropped; return 0, for no answer. */
uint8_t hfp_drop(hfp_drive *drive, hfp_counter reason);

/* Operations and results of parameter access, as on the wire. */
enum {
    HFP_OP_READ = 0x00,
    HFP_OP_WRITE = 0x01,
    HFP_OP_OK = 0x10,
    HFP_OP_UNKNOWN_INDEX = 0x11,
    HFP_OP_READ_ONLY = 0x12,
    HFP_OP_OUT_OF_RANGE = 0x13,
    HFP_OP_WRONG_STATE = 0x14,
    HFP_OP_UNKNOWN_OP = 0x15
};

/* Fill in what a configuration says of values that are nought; false when one is out of its bounds. */
bool hfp_parameters_init(int32_t values[HFP_ROWS], const hfp_config *config);

/* Read or write; return the result and the value then in force (0 where there is no such parameter). */
uint8_t hfp_parameters_execute(
    int32_t values[HFP_ROWS], uint8_t op, uint16_t index, int32_t value, bool disabled, int32_t *held);

#endif
