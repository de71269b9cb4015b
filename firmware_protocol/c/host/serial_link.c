/* Streams of bytes: a pseudo terminal or standard input and output; and what all links have in common. */
#include "host.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <termios.h>
#include <unistd.h>

static bool set_raw(int terminal)
{
    struct termios settings;

    if (tcgetattr(terminal, &settings) != 0) {
        return false;
    }
    settings.c_iflag = 0;
    settings.c_oflag = 0;
    settings.c_lflag = 0;
    settings.c_cflag = CS8 | CREAD | CLOCAL;
    settings.c_cc[VMIN] = 1;
    settings.c_cc[VTIME] = 0;
    return tcsetattr(terminal, TCSANOW, &settings) == 0;
}

/* Put the link in place; one left over from before goes, anything else stays. */
static bool make_link(const char *path, const char *device)
{
    struct stat found;

    if (lstat(path, &found) == 0 && S_ISLNK(found.st_mode) && unlink(path) != 0) {
        return false;
    }
    return symlink(device, path) == 0;
}

bool link_open_pty(host_link *link, const char *path, char *where, size_t size)
{
    memset(link, 0, sizeof *link);
    link->far_end = -1;
    link->in = link->out = posix_openpt(O_RDWR | O_NOCTTY | O_NONBLOCK);
    if (link->in < 0 || grantpt(link->in) != 0 || unlockpt(link->in) != 0) {
        return false;
    }
    const char *device = ptsname(link->in);
    if (device == NULL) {
        return false;
    }
    link->far_end = open(device, O_RDWR | O_NOCTTY);
    if (link->far_end < 0 || !set_raw(link->far_end) || !make_link(path, device)) {
        return false;
    }
    (void)snprintf(where, size, "serial %s %s", path, device);
    return hfp_serial_init(&link->reader, HFP_MAX_PAYLOAD);
}

bool link_open_stdio(host_link *link, char *where, size_t size)
{
    memset(link, 0, sizeof *link);
    link->in = STDIN_FILENO;
    link->out = STDOUT_FILENO;
    link->far_end = -1;
    (void)snprintf(where, size, "stdio");
    return fcntl(link->in, F_SETFL, O_NONBLOCK) == 0 && fcntl(link->out, F_SETFL, O_NONBLOCK) == 0 &&
           hfp_serial_init(&link->reader, HFP_MAX_PAYLOAD);
}

void link_close(host_link *link, const char *path)
{
    char target[128];
    ssize_t length = path == NULL ? -1 : readlink(path, target, sizeof target - 1);

    if (length > 0) { /* the link goes too, if it is still ours */
        target[length] = '\0';
        const char *device = ptsname(link->in);
        if (device != NULL && strcmp(target, device) == 0) {
            (void)unlink(path);
        }
    }
    (void)close(link->in);
    if (link->far_end >= 0) {
        (void)close(link->far_end);
    }
}

/* Read what is there; false: nothing. A datagram that ends within a packet is closed, so it can't spoil the next. */
static bool refill(host_link *link)
{
    struct sockaddr_in from;
    socklen_t size = sizeof from;
    size_t room = sizeof link->bytes - 1;
    ssize_t got = link->datagrams ? recvfrom(link->in, link->bytes, room, 0, (struct sockaddr *)&from, &size)
                                  : read(link->in, link->bytes, room);

    if (got < 0) {
        return false;
    }
    if (got == 0 && !link->datagrams) {
        link->ended = true;
        return false;
    }
    link->at = 0;
    link->filled = (size_t)got;
    if (link->datagrams) {
        link->bytes[link->filled++] = 0;
        link->peer = from;
        link->has_peer = true;
    }
    return true;
}

bool link_receive(host_link *link, hfp_frame *frame)
{
    if (link->is_can) {
        return can_receive(link, frame);
    }
    do {
        while (link->at < link->filled) {
            if (hfp_serial_feed(&link->reader, link->bytes[link->at++], frame)) {
                return true;
            }
        }
    } while (refill(link));
    return false;
}

bool link_send(host_link *link, const hfp_frame *frame)
{
    uint8_t packet[HFP_MAX_PACKET];
    size_t length;
    ssize_t sent;

    if (link->is_can) {
        return can_send(link, frame);
    }
    length = hfp_serial_encode(frame, packet);
    if (link->datagrams) {
        if (!link->has_peer) {
            return false;
        }
        sent = sendto(link->out, packet, length, 0, (const struct sockaddr *)&link->peer, sizeof link->peer);
        return sent == (ssize_t)length;
    }
    sent = write(link->out, packet, length);
    if (sent == (ssize_t)length) {
        return true;
    }
    if (link->far_end >= 0) { /* nobody reads: a host that comes back finds at most one buffer of old frames */
        (void)tcflush(link->far_end, TCIFLUSH);
    } else if (sent < 0 && errno == EPIPE) {
        link->ended = true;
    }
    return false;
}
