/* SocketCAN: frames as the kernel has them. What is no data frame with an 11-bit id is not of this protocol. */
#include "host.h"

#include <errno.h>
#include <fcntl.h>
#include <linux/can.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

bool link_open_can(host_link *link, const char *device, char *where, size_t size)
{
    const int on = 1;
    struct sockaddr_can address;

    memset(link, 0, sizeof *link);
    memset(&address, 0, sizeof address);
    link->is_can = true;
    link->far_end = -1;
    link->in = link->out = socket(PF_CAN, SOCK_RAW, CAN_RAW);
    if (link->in < 0) {
        return false;
    }
    address.can_family = AF_CAN;
    address.can_ifindex = (int)if_nametoindex(device);
    /* FD frames are heard on a classic drive too, to be counted (HFP-022); a device without FD sends none. */
    if (address.can_ifindex == 0 ||
        setsockopt(link->in, SOL_CAN_RAW, CAN_RAW_FD_FRAMES, &on, sizeof on) != 0 ||
        fcntl(link->in, F_SETFL, O_NONBLOCK) != 0 ||
        bind(link->in, (const struct sockaddr *)&address, sizeof address) != 0) {
        int reason = errno;
        (void)close(link->in);
        errno = reason;
        return false;
    }
    (void)snprintf(where, size, "can %s", device);
    return true;
}

bool can_receive(host_link *link, hfp_frame *frame)
{
    struct canfd_frame found;
    ssize_t got;

    while ((got = read(link->in, &found, sizeof found)) > 0) {
        if ((found.can_id & (CAN_EFF_FLAG | CAN_RTR_FLAG | CAN_ERR_FLAG)) == 0) {
            frame->id = (uint16_t)found.can_id;
            frame->is_fd = got == (ssize_t)CANFD_MTU;
            frame->length = found.len;
            memcpy(frame->data, found.data, found.len);
            return true;
        }
    }
    link->ended = got < 0 && errno == ENODEV; /* the device has gone for good; one that is down may come up again */
    return false;
}

bool can_send(const host_link *link, const hfp_frame *frame)
{
    struct canfd_frame sent;
    size_t size = frame->is_fd ? CANFD_MTU : CAN_MTU;

    memset(&sent, 0, sizeof sent);
    sent.can_id = frame->id;
    sent.len = frame->length;
    sent.flags = frame->is_fd ? CANFD_BRS : 0;
    memcpy(sent.data, frame->data, frame->length);
    return write(link->out, &sent, size) == (ssize_t)size;
}
