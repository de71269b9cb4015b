/*
 * Fuzz target: the input is a history. Each byte says what happens next to a node behind a port of this file, to a serial
 * reader, or to the clock; what must hold always is checked after each.
 */
#include "../hfp.h"

#include <stdlib.h>
#include <string.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

typedef struct {
    const uint8_t *data;
    size_t left;
    uint32_t now_us;
    int32_t theta_m_raw;
    float current_A;
    hfp_fault fault;
    hfp_frame waiting;
    bool is_waiting;
    uint8_t sample_sequence; /* seen in the last measurement, for references that are fresh */
} history;

static void require(bool holds)
{
    if (!holds) {
        abort();
    }
}

static uint8_t next(history *h)
{
    if (h->left == 0) {
        return 0;
    }
    h->left--;
    return *h->data++;
}

static uint16_t next16(history *h)
{
    uint8_t low = next(h);

    return (uint16_t)(low | next(h) << 8);
}

static uint32_t next32(history *h)
{
    uint16_t low = next16(h);

    return low | (uint32_t)next16(h) << 16;
}

static bool port_receive(void *context, hfp_frame *frame)
{
    history *h = context;
    bool was = h->is_waiting;

    if (was) {
        *frame = h->waiting;
    }
    h->is_waiting = false;
    return was;
}

/* What a drive sends is whole, and comes back from a packet as it was. */
static bool port_send(void *context, const hfp_frame *frame)
{
    history *h = context;
    hfp_serial_reader reader;
    hfp_frame back;
    uint8_t packet[HFP_MAX_PACKET];
    size_t length = hfp_serial_encode(frame, packet);

    require(hfp_verify(frame) == HFP_INTACT && length > 0);
    require(hfp_serial_init(&reader, HFP_MAX_PAYLOAD));
    for (size_t i = 0; i < length; i++) {
        require(hfp_serial_feed(&reader, packet[i], &back) == (i + 1 == length));
    }
    require(back.id == frame->id && back.is_fd == frame->is_fd && back.length == frame->length);
    require(memcmp(back.data, frame->data, frame->length) == 0);
    if (frame->id >> 5 == HFP_FEEDBACK) {
        h->sample_sequence = frame->data[6];
    } else if (frame->id >> 5 == HFP_FD_FEEDBACK) {
        h->sample_sequence = frame->data[10];
    }
    return (frame->data[0] & 1) != 0;
}

static uint32_t port_now_us(void *context)
{
    return ((history *)context)->now_us;
}

static void port_measure(void *context, hfp_reading *reading)
{
    history *h = context;

    reading->stamp_us = h->now_us;
    reading->theta_m_raw = h->theta_m_raw;
    reading->current_raw = (int32_t)next32(h);
}

static hfp_fault port_protection(void *context)
{
    return ((history *)context)->fault;
}

static void port_set_current(void *context, float current_A)
{
    ((history *)context)->current_A = current_A;
}

static void port_keep_node(void *context, uint8_t node)
{
    (void)context;
    require(node >= 1 && node <= HFP_MAX_NODE);
}

static const hfp_port PORT = {
    port_receive, port_send, port_now_us, port_measure, port_protection, port_set_current, port_keep_node};

/* A frame as wild as the input, or one with the right check that makes sense. */
static void draw_frame(history *h, const hfp_node *node)
{
    static const hfp_function FUNCTIONS[] = {HFP_HOST_HEARTBEAT, HFP_SETPOINT, HFP_FD_SETPOINT, HFP_PARAM_REQUEST,
                                             HFP_ASSIGN_NODE, HFP_DISCOVER, HFP_ESTOP, HFP_TIMING};
    uint8_t choice = next(h);
    hfp_frame *frame = &h->waiting;

    memset(frame, 0, sizeof *frame);
    if ((choice & 0xC0) == 0xC0) {
        frame->id = next16(h);
        frame->is_fd = (choice & 1) != 0;
        frame->length = next(h) % (HFP_MAX_PAYLOAD + 1);
        for (uint8_t i = 0; i < frame->length; i++) {
            frame->data[i] = next(h);
        }
    } else {
        hfp_function function = FUNCTIONS[choice & 7];
        for (uint8_t i = 0; i < 7; i++) {
            frame->data[i] = next(h);
        }
        if ((choice & 0x40) == 0 && (function == HFP_SETPOINT || function == HFP_FD_SETPOINT)) {
            uint32_t reference = (uint32_t)h->theta_m_raw + (uint32_t)frame->data[0];
            for (unsigned i = 0; i < 4; i++) {
                frame->data[i] = (uint8_t)(reference >> 8 * i);
            }
            frame->data[4] = (uint8_t)(node->drive.setpoint_sequence + 1);
            frame->data[5] = h->sample_sequence;
        } else if ((choice & 0x40) == 0 && function == HFP_HOST_HEARTBEAT) {
            frame->data[0] &= 3;
            frame->data[1] = HFP_PROTOCOL_MAJOR;
            frame->data[6] = (uint8_t)(node->drive.host_sequence + 1);
        }
        hfp_seal(frame, function, function == HFP_ASSIGN_NODE ? 0 : node->drive.node);
    }
    h->is_waiting = true;
}

static void check(const history *h, const hfp_node *node)
{
    const hfp_drive *drive = &node->drive;

    require(drive->state < HFP_STATES && drive->fault < HFP_FAULTS);
    require((drive->fault != HFP_FAULT_NONE) == (drive->state == HFP_FAULT));
    require(drive->has_reference == (drive->state == HFP_OPERATIONAL));
    require(h->current_A >= -1.0F && h->current_A <= 1.0F);
    require(drive->has_reference || h->current_A == 0.0F);
    require(drive->node >= 1 && drive->node <= HFP_MAX_NODE && drive->node == drive->values[HFP_ROW_NODE]);
    require(drive->values[HFP_ROW_THETA_MIN] <= drive->values[HFP_ROW_THETA_MAX]);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static const hfp_loop_config LOOP = {1.0e-3F, 1.2F, 15.0F, 6.0e-3F, 150.0F, 1.0F, 0.0F};
    history h = {.data = data, .left = size};
    hfp_node node;
    hfp_serial_reader reader;
    hfp_frame frame;
    hfp_config config = hfp_config_default(3, 0x123456789ABC);

    config.fd = (next(&h) & 1) != 0;
    h.theta_m_raw = (int32_t)next32(&h);
    require(hfp_node_init(&node, &config, &LOOP, 1, &PORT, &h));
    require(hfp_serial_init(&reader, HFP_MAX_PAYLOAD));
    while (h.left > 0) {
        uint8_t what = next(&h);
        switch (what & 7) {
        case 0:
            h.now_us += what < 0xF0 ? 16u * next(&h) : next16(&h);
            break;
        case 1:
            h.theta_m_raw = (int32_t)((uint32_t)h.theta_m_raw + (uint32_t)(int8_t)next(&h));
            hfp_node_sample(&node);
            break;
        case 2:
            h.fault = what < 0xF0 ? HFP_FAULT_NONE : (hfp_fault)(next(&h) % HFP_FAULTS);
            hfp_node_service(&node);
            h.fault = HFP_FAULT_NONE;
            break;
        case 3:
            for (uint8_t count = next(&h) % 32; count > 0; count--) {
                h.is_waiting = hfp_serial_feed(&reader, next(&h), &frame);
                if (h.is_waiting) {
                    h.waiting = frame;
                    hfp_node_service(&node);
                }
            }
            break;
        default:
            draw_frame(&h, &node);
            hfp_node_service(&node);
            break;
        }
        check(&h, &node);
    }
    return 0;
}
