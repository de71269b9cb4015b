/*
 * The plant outside this process, as its clock: nothing happens but when the plant says so, so a run is the same each
 * time. A datagram of 16 bytes, little-endian: u32 now_us, i32 theta_m_raw, i32 current_raw, u32 what. Of `what`, bit 0:
 * sample when frames are taken and time has passed; bit 1: take frames until there were, modulo 256 and since the start,
 * as many as bits 8 to 15 say, for a link that is slower than this one. The answer, 8 bytes: f32 current_A to hold from
 * now on, u8 state, u8 fault, u8 node, u8 frames sent since the start, modulo 256.
 */
#include "host.h"

#include <poll.h>
#include <string.h>
#include <sys/socket.h>

enum { REQUEST_BYTES = 16, ANSWER_BYTES = 8, WHAT_SAMPLE = 1, WHAT_FRAMES = 2, FRAMES_SHIFT = 8 };

static uint32_t load32(const uint8_t *data)
{
    return (uint32_t)data[0] | (uint32_t)data[1] << 8 | (uint32_t)data[2] << 16 | (uint32_t)data[3] << 24;
}

bool lockstep_wait(lockstep *plant, int timeout_ms)
{
    uint8_t data[REQUEST_BYTES + 1];
    socklen_t size = sizeof plant->peer;
    struct pollfd waiting = {.fd = plant->socket, .events = POLLIN, .revents = 0};

    if (poll(&waiting, 1, timeout_ms) <= 0 ||
        recvfrom(plant->socket, data, sizeof data, 0, (struct sockaddr *)&plant->peer, &size) != REQUEST_BYTES) {
        return false;
    }
    plant->reading.stamp_us = load32(data);
    plant->reading.theta_m_raw = (int32_t)load32(&data[4]);
    plant->reading.current_raw = (int32_t)load32(&data[8]);
    plant->what = load32(&data[12]);
    return true;
}

bool lockstep_samples(const lockstep *plant)
{
    return (plant->what & WHAT_SAMPLE) != 0;
}

bool lockstep_misses(const lockstep *plant, uint8_t taken)
{
    return (plant->what & WHAT_FRAMES) != 0 && (uint8_t)(plant->what >> FRAMES_SHIFT) != taken;
}

void lockstep_answer(const lockstep *plant, const hfp_node *node, float current_A, uint8_t sent)
{
    uint32_t bits;
    uint8_t data[ANSWER_BYTES];

    memcpy(&bits, &current_A, sizeof bits);
    for (unsigned i = 0; i < sizeof bits; i++) {
        data[i] = (uint8_t)(bits >> 8 * i);
    }
    data[4] = node->drive.state;
    data[5] = node->drive.fault;
    data[6] = node->drive.node;
    data[7] = sent;
    (void)sendto(plant->socket, data, sizeof data, 0, (const struct sockaddr *)&plant->peer, sizeof plant->peer);
}
