/* Check values, and which id, format and length each message has. */
#include "hfp_private.h"

enum { NODE_BITS = 5, NODE_MASK = 31 };

enum { FORMAT_UNKNOWN, FORMAT_CLASSIC, FORMAT_FD, FORMAT_ANY };
enum { CHECK_NONE, CHECK_CRC8, CHECK_CRC16 };

typedef struct {
    uint8_t format;
    uint8_t check;
    uint8_t length; /* with the check value; of no meaning with FORMAT_ANY */
    uint8_t lowest_node;
    uint8_t highest_node;
} layout;

static const layout LAYOUTS[] = {
    [HFP_ESTOP] = {FORMAT_ANY, CHECK_NONE, 0, 0, HFP_MAX_NODE},
    [HFP_SETPOINT] = {FORMAT_CLASSIC, CHECK_CRC8, 8, 1, HFP_MAX_NODE},
    [HFP_FD_SETPOINT] = {FORMAT_FD, CHECK_CRC16, 8, 1, HFP_MAX_NODE},
    [HFP_FEEDBACK] = {FORMAT_CLASSIC, CHECK_CRC8, 8, 1, HFP_MAX_NODE},
    [HFP_TIMING] = {FORMAT_CLASSIC, CHECK_CRC8, 8, 1, HFP_MAX_NODE},
    [HFP_FD_FEEDBACK] = {FORMAT_FD, CHECK_CRC16, 16, 1, HFP_MAX_NODE},
    [HFP_HOST_HEARTBEAT] = {FORMAT_CLASSIC, CHECK_CRC8, 8, 1, HFP_MAX_NODE},
    [HFP_DRIVE_HEARTBEAT] = {FORMAT_CLASSIC, CHECK_CRC8, 8, 1, HFP_MAX_NODE},
    [HFP_BENCH_SENSOR] = {FORMAT_CLASSIC, CHECK_CRC8, 8, 1, HFP_MAX_NODE},
    [HFP_PARAM_REQUEST] = {FORMAT_CLASSIC, CHECK_CRC8, 8, 1, HFP_MAX_NODE},
    [HFP_PARAM_RESPONSE] = {FORMAT_CLASSIC, CHECK_CRC8, 8, 1, HFP_MAX_NODE},
    [HFP_DISCOVER] = {FORMAT_CLASSIC, CHECK_NONE, 0, 0, HFP_MAX_NODE},
    [HFP_IDENTITY] = {FORMAT_CLASSIC, CHECK_NONE, 8, 1, HFP_MAX_NODE},
    [HFP_ASSIGN_NODE] = {FORMAT_CLASSIC, CHECK_CRC8, 8, 0, 0},
};

enum { FUNCTIONS = sizeof LAYOUTS / sizeof LAYOUTS[0] };

/* Sixteen entries, two look-ups a byte: a tenth of the flash of the whole table for twice the time. */
static const uint8_t CRC8_NIBBLE[16] = {
    0x00, 0x2F, 0x5E, 0x71, 0xBC, 0x93, 0xE2, 0xCD, 0x57, 0x78, 0x09, 0x26, 0xEB, 0xC4, 0xB5, 0x9A};

static uint8_t crc8_byte(uint8_t crc, uint8_t byte)
{
    crc ^= byte;
    crc = (uint8_t)((uint8_t)(crc << 4) ^ CRC8_NIBBLE[crc >> 4]);
    return (uint8_t)((uint8_t)(crc << 4) ^ CRC8_NIBBLE[crc >> 4]);
}

uint8_t hfp_crc8(uint16_t id, const uint8_t *data, size_t length)
{
    uint8_t crc = crc8_byte(crc8_byte(0xFF, (uint8_t)id), (uint8_t)(id >> 8));

    for (size_t i = 0; i < length; i++) {
        crc = crc8_byte(crc, data[i]);
    }
    return crc ^ 0xFF;
}

uint16_t hfp_crc16(uint16_t crc, const uint8_t *data, size_t length)
{
    /* What the polynomial 0x1021 does to eight bits at once, without a table. */
    for (size_t i = 0; i < length; i++) {
        uint8_t x = (uint8_t)((crc >> 8) ^ data[i]);
        x ^= (uint8_t)(x >> 4);
        crc = (uint16_t)((crc << 8) ^ (x << 12) ^ (x << 5) ^ x);
    }
    return crc;
}

static uint16_t crc16_of(uint16_t id, const uint8_t *data, size_t length)
{
    const uint8_t head[2] = {(uint8_t)id, (uint8_t)(id >> 8)};

    return hfp_crc16(hfp_crc16(HFP_CRC16_INIT, head, sizeof head), data, length);
}

uint16_t hfp_id(hfp_function function, uint8_t node)
{
    return (uint16_t)((unsigned)function << NODE_BITS | node);
}

hfp_function hfp_function_of(uint16_t id)
{
    return (hfp_function)(id >> NODE_BITS);
}

uint8_t hfp_node_of(uint16_t id)
{
    return id & NODE_MASK;
}

static bool is_intact(const layout *row, const hfp_frame *frame)
{
    const uint8_t *data = frame->data;

    switch (row->check) {
    case CHECK_CRC8:
        return hfp_crc8(frame->id, data, row->length - 1u) == data[row->length - 1];
    case CHECK_CRC16:
        return crc16_of(frame->id, data, row->length - 2u) == hfp_load16(&data[row->length - 2]);
    default:
        return true;
    }
}

hfp_verdict hfp_verify(const hfp_frame *frame)
{
    unsigned function = (unsigned)hfp_function_of(frame->id);
    uint8_t node = hfp_node_of(frame->id);

    if (function >= FUNCTIONS) {
        return HFP_UNKNOWN_ID;
    }
    const layout *row = &LAYOUTS[function];
    if (row->format == FORMAT_UNKNOWN || node < row->lowest_node || node > row->highest_node) {
        return HFP_UNKNOWN_ID;
    }
    if (row->format == FORMAT_ANY) {
        return HFP_INTACT;
    }
    if (frame->is_fd != (row->format == FORMAT_FD)) {
        return HFP_BAD_FORMAT;
    }
    if (frame->length != row->length) {
        return HFP_BAD_LENGTH;
    }
    return is_intact(row, frame) ? HFP_INTACT : HFP_BAD_CRC;
}

void hfp_seal(hfp_frame *frame, hfp_function function, uint8_t node)
{
    const layout *row = &LAYOUTS[function];
    uint8_t *data = frame->data;

    frame->id = hfp_id(function, node);
    frame->is_fd = row->format == FORMAT_FD;
    frame->length = row->length;
    if (row->check == CHECK_CRC8) {
        data[row->length - 1] = hfp_crc8(frame->id, data, row->length - 1u);
    } else if (row->check == CHECK_CRC16) {
        hfp_store16(&data[row->length - 2], crc16_of(frame->id, data, row->length - 2u));
    }
}
