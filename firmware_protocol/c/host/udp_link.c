/* Datagram sockets: one serial packet each, so the bytes are those of the serial line (HFP-160). */
#include "host.h"

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

int udp_bind(const char *address, struct sockaddr_in *bound)
{
    char host[64];
    char *end;
    const char *colon = strrchr(address, ':');
    socklen_t size = sizeof *bound;

    if (colon == NULL || (size_t)(colon - address) >= sizeof host) {
        errno = EINVAL;
        return -1;
    }
    memcpy(host, address, (size_t)(colon - address));
    host[colon - address] = '\0';
    unsigned long port = strtoul(colon + 1, &end, 10);
    memset(bound, 0, sizeof *bound);
    bound->sin_family = AF_INET;
    bound->sin_port = htons((uint16_t)port);
    if (*end != '\0' || end == colon + 1 || port > 65535 || inet_pton(AF_INET, host, &bound->sin_addr) != 1) {
        errno = EINVAL;
        return -1;
    }
    int descriptor = socket(AF_INET, SOCK_DGRAM, 0);
    if (descriptor < 0) {
        return -1;
    }
    if (fcntl(descriptor, F_SETFL, O_NONBLOCK) != 0 ||
        bind(descriptor, (const struct sockaddr *)bound, sizeof *bound) != 0 ||
        getsockname(descriptor, (struct sockaddr *)bound, &size) != 0) {
        int reason = errno;
        close(descriptor);
        errno = reason;
        return -1;
    }
    return descriptor;
}

bool link_open_udp(host_link *link, const char *address, char *where, size_t size)
{
    struct sockaddr_in bound;
    char host[INET_ADDRSTRLEN];

    memset(link, 0, sizeof *link);
    link->in = link->out = udp_bind(address, &bound);
    link->far_end = -1;
    link->datagrams = true;
    if (link->in < 0) {
        return false;
    }
    (void)inet_ntop(AF_INET, &bound.sin_addr, host, sizeof host);
    (void)snprintf(where, size, "udp %s:%u", host, (unsigned)ntohs(bound.sin_port));
    return hfp_serial_init(&link->reader, HFP_MAX_PAYLOAD);
}
