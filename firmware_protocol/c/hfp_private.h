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
