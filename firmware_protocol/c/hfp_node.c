/* The drive with its position loop, behind the port of a device. */
#include "hfp_private.h"

#include <string.h>

static void send(hfp_node *node, const hfp_frame *frames, uint8_t count)
{
    for (uint8_t i = 0; i < count; i++) {
        if (!node->port->send(node->context, &frames[i])) {
            node->unsent++;
        }
    }
}

static void poll(hfp_node *node)
{
    hfp_frame frames[HFP_MAX_ANSWERS];

    hfp_drive_trip(&node->drive, node->port->protection(node->context));
    send(node, frames, hfp_drive_poll(&node->drive, node->port->now_us(node->context), frames));
    if (!node->drive.has_reference) {
        node->port->set_current(node->context, 0);
    }
}

static void take(hfp_node *node, const hfp_frame *frame)
{
    hfp_frame answers[HFP_MAX_ANSWERS];
    hfp_drive *drive = &node->drive;
    uint8_t before = drive->node;
    uint8_t count =
        hfp_drive_receive(drive, frame, node->port->now_us(node->context), node->theta_m_raw, answers);

    send(node, answers, count);
    if (drive->node != before) {
        node->port->keep_node(node->context, drive->node);
    }
}

bool hfp_node_init(
    hfp_node *node,
    const hfp_config *config,
    const hfp_loop_config *loop,
    uint16_t feedback_divider,
    const hfp_port *port,
    void *context)
{
    hfp_reading reading;

    memset(node, 0, sizeof *node);
    node->port = port;
    node->context = context;
    node->feedback_divider = feedback_divider;
    port->set_current(context, 0);
    port->measure(context, &reading);
    node->theta_m_raw = reading.theta_m_raw;
    return feedback_divider > 0 && hfp_loop_init(&node->loop, loop, reading.theta_m_raw) &&
           hfp_drive_init(&node->drive, config);
}

void hfp_node_service(hfp_node *node)
{
    hfp_frame frame;

    for (unsigned i = 0; i < HFP_MAX_BURST && node->port->receive(node->context, &frame); i++) {
        take(node, &frame);
    }
    poll(node);
}

void hfp_node_sample(hfp_node *node)
{
    hfp_frame frames[HFP_MAX_ANSWERS];
    hfp_reading reading;
    hfp_drive *drive = &node->drive;

    poll(node);
    node->port->measure(node->context, &reading);
    node->theta_m_raw = reading.theta_m_raw;
    float current_A = hfp_loop_step(&node->loop, drive->has_reference, drive->reference_raw, reading.theta_m_raw);
    node->port->set_current(node->context, current_A);
    if (node->until_feedback == 0) {
        node->until_feedback = node->feedback_divider;
        send(node, frames,
             hfp_drive_sample(drive, reading.stamp_us, reading.theta_m_raw, reading.current_raw, frames));
    }
    node->until_feedback--;
}
