#include "net.h"

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

int net_listen(int port, int *chosen) {
    const int fd = socket(AF_INET, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    if (fd < 0) {
        return -1;
    }
    const int on = 1;
    setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &on, sizeof(on));
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_port = htons((uint16_t)port)};
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof(address);
    if (bind(fd, (struct sockaddr *)&address, size) != 0 || listen(fd, 8) != 0 ||
        getsockname(fd, (struct sockaddr *)&address, &size) != 0) {
        const int error = errno;
        close(fd);
        errno = error;
        return -1;
    }
    *chosen = ntohs(address.sin_port);
    return fd;
}

void net_accept(int listener, net_connection_t *connections, size_t count) {
    const int fd = accept4(listener, NULL, NULL, SOCK_NONBLOCK | SOCK_CLOEXEC);
    if (fd < 0) {
        return;
    }
    const int on = 1;
    setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof(on));
    for (size_t i = 0; i < count; i++) {
        if (connections[i].fd < 0) {
            connections[i].fd = fd;
            connections[i].closing = false;
            connections[i].in_fill = 0;
            connections[i].out_fill = 0;
            return;
        }
    }
    close(fd);
}

bool net_read(net_connection_t *connection) {
    const size_t room = sizeof(connection->in) - connection->in_fill;
    if (room == 0) {
        return true;
    }
    const ssize_t got = recv(connection->fd, connection->in + connection->in_fill, room, 0);
    if (got > 0) {
        connection->in_fill += (size_t)got;
        return true;
    }
    return got < 0 && (errno == EAGAIN || errno == EINTR);
}

bool net_write(net_connection_t *connection) {
    while (connection->out_fill > 0) {
        const ssize_t sent = send(connection->fd, connection->out, connection->out_fill, MSG_NOSIGNAL);
        if (sent < 0) {
            return errno == EAGAIN || errno == EINTR;
        }
        connection->out_fill -= (size_t)sent;
        memmove(connection->out, connection->out + sent, connection->out_fill);
    }
    return !connection->closing;
}

void net_close(net_connection_t *connection) {
    if (connection->fd >= 0) {
        close(connection->fd);
        connection->fd = -1;
    }
}

void net_consume(net_connection_t *connection, size_t size) {
    connection->in_fill -= size;
    memmove(connection->in, connection->in + size, connection->in_fill);
}

size_t net_room(const net_connection_t *connection) {
    return sizeof(connection->out) - connection->out_fill;
}

void net_put(net_connection_t *connection, const void *bytes, size_t size) {
    if (size > net_room(connection)) {
        connection->closing = true; // a peer that asks and never reads
        return;
    }
    memcpy(connection->out + connection->out_fill, bytes, size);
    connection->out_fill += size;
}

struct pollfd net_poll(const net_connection_t *connection) {
    short events = 0;
    if (connection->in_fill < sizeof(connection->in) && !connection->closing) {
        events = POLLIN;
    }
    if (connection->out_fill > 0 || connection->closing) {
        events = (short)(events | POLLOUT);
    }
    return (struct pollfd){.fd = connection->fd, .events = events};
}
