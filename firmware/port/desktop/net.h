// Sockets of the desktop board: non-blocking, fixed buffers, served from one poll loop.
#ifndef NET_H
#define NET_H

#include <poll.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define NET_IN  (128 * 1024)
#define NET_OUT (1024 * 1024)

typedef struct {
    int fd;       // -1: free
    bool closing; // once all is written
    size_t in_fill;
    size_t out_fill;
    uint8_t in[NET_IN];
    uint8_t out[NET_OUT];
} net_connection_t;

// Listens on 127.0.0.1; port 0 lets the system choose. Returns the descriptor and the port, or -1 with errno.
int net_listen(int port, int *chosen);

// Takes a waiting connection into the first free slot, refuses it where there is none.
void net_accept(int listener, net_connection_t *connections, size_t count);

bool net_read(net_connection_t *connection);  // false: the other end is gone
bool net_write(net_connection_t *connection); // likewise
void net_close(net_connection_t *connection);
void net_consume(net_connection_t *connection, size_t size); // drops the first bytes of `in`
size_t net_room(const net_connection_t *connection);
void net_put(net_connection_t *connection, const void *bytes, size_t size); // within net_room
struct pollfd net_poll(const net_connection_t *connection);

#endif
