// tautline-board: the desktop board. docs/protocol.md says how to reach it.
#include <errno.h>
#include <getopt.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "board.h"
#include "loader.h"
#include "simlink.h"
#include "uart.h"
#include "usbip.h"

static volatile sig_atomic_t stopped;

static void stop(int signal_number) {
    (void)signal_number;
    stopped = 1;
}

static _Noreturn void usage(const char *what) {
    fprintf(stderr,
            "tautline-board: %s\n"
            "usage: tautline-board --usbip PORT | --uart PORT --sim PORT [--flash FILE] [--axes 1..4] [--rate HZ] "
            "[--serial S] [--update-key HEX] [--realtime] [--parent PID]\n"
            "ports: 0 lets the system choose; the line of JSON on stdout names them\n",
            what);
    exit(2);
}

static long integer(const char *text, long least, long most, const char *what) {
    char *end;
    errno = 0;
    const long value = strtol(text, &end, 10);
    if (end == text || *end != '\0' || errno != 0 || value < least || value > most) {
        usage(what);
    }
    return value;
}

typedef struct {
    net_connection_t *connections;
    size_t count;
    int listener;
    void (*closed)(net_connection_t *connection);
} service_t;

static size_t collect(const service_t *service, struct pollfd *fds) {
    fds[0] = (struct pollfd){.fd = service->listener, .events = POLLIN};
    for (size_t i = 0; i < service->count; i++) {
        fds[1 + i] = net_poll(&service->connections[i]);
    }
    return 1 + service->count;
}

static void exchange(const service_t *service, const struct pollfd *fds) {
    for (size_t i = 0; i < service->count; i++) {
        net_connection_t *connection = &service->connections[i];
        if (connection->fd < 0 || fds[1 + i].fd != connection->fd) {
            continue;
        }
        const bool readable = (fds[1 + i].revents & (POLLIN | POLLHUP | POLLERR)) != 0;
        if (readable && !net_read(connection)) {
            service->closed(connection);
        }
    }
    if ((fds[0].revents & POLLIN) != 0) {
        net_accept(service->listener, service->connections, service->count);
    }
}

static void flush(const service_t *service) {
    for (size_t i = 0; i < service->count; i++) {
        if (service->connections[i].fd >= 0 && !net_write(&service->connections[i])) {
            service->closed(&service->connections[i]);
        }
    }
}

// `host` is USB/IP or the serial port.
static void serve(const service_t *host, const service_t *sim, long parent) {
    struct pollfd fds[2 + USBIP_CONNECTIONS + SIMLINK_CONNECTIONS];
    bool ran = false;
    uint32_t starts = board_state()->starts;
    while (stopped == 0 && !simlink_quit() && (parent == 0 || getppid() == (pid_t)parent)) {
        const size_t first = collect(host, fds);
        const size_t all = first + collect(sim, fds + first);
        const int idle = simlink_wait();
        const int patience = parent != 0 && (idle < 0 || idle > 500) ? 500 : idle;
        if (poll(fds, (nfds_t)all, ran ? 0 : patience) < 0 && errno != EINTR) {
            break;
        }
        exchange(host, fds);
        usbip_receive();
        do { // the device has room for one packet, and waits for no socket
            board_task();
        } while (usbip_transfer());
        exchange(sim, fds + first);
        uart_receive();
        board_task();
        simlink_receive();
        ran = simlink_run();
        ran = usbip_transfer() || ran;
        if (board_state()->starts != starts) { // a restart, for whatever reason, leaves the bus
            usbip_plug(false);
            starts = board_state()->starts;
        }
        usbip_plug(simlink_cable() && board_on_bus());
        flush(host);
        flush(sim);
    }
}

int main(int argc, char **argv) {
    static const struct option options[] = {
        {"usbip", required_argument, NULL, 'u'},
        {"uart", required_argument, NULL, 'l'},
        {"sim", required_argument, NULL, 's'},
        {"flash", required_argument, NULL, 'f'},
        {"axes", required_argument, NULL, 'a'},
        {"rate", required_argument, NULL, 'r'},
        {"serial", required_argument, NULL, 'n'},
        {"realtime", no_argument, NULL, 't'},
        {"parent", required_argument, NULL, 'p'},
        {"update-key", required_argument, NULL, 'k'},
        {NULL, 0, NULL, 0},
    };
    board_options_t board = {.axes = 1, .control_hz = 5000, .serial = "DESKTOP-1"};
    int host_port = -1;
    int sim_port = -1;
    bool realtime = false;
    long parent = 0;
    int option;
    while ((option = getopt_long(argc, argv, "", options, NULL)) != -1) {
        switch (option) {
        case 'u':
        case 'l':
            board.on_uart = option == 'l';
            host_port = (int)integer(optarg, 0, 65535, "--usbip and --uart take a port");
            break;
        case 's':
            sim_port = (int)integer(optarg, 0, 65535, "--sim takes a port");
            break;
        case 'f':
            board.flash_file = optarg;
            break;
        case 'a':
            board.axes = (uint8_t)integer(optarg, 1, TL_WIRE_AXES_MAX, "--axes takes 1 to 4");
            break;
        case 'r':
            board.control_hz =
                (uint32_t)integer(optarg, 1000, 10000, "--rate takes 1000, 2000, 4000, 5000, 8000 or 10000 Hz");
            break;
        case 'n':
            board.serial = optarg;
            break;
        case 'k':
            if (!loader_key(optarg)) {
                usage("--update-key takes 64 hexadecimal digits");
            }
            break;
        case 't':
            realtime = true;
            break;
        case 'p':
            parent = integer(optarg, 1, 0x7FFFFFFF, "--parent takes a process id");
            break;
        default:
            usage("unknown option");
        }
    }
    if (host_port < 0 || sim_port < 0 || optind != argc) {
        usage("--usbip or --uart, and --sim are needed, and nothing but options");
    }
    if (1000000U % board.control_hz != 0U || board.control_hz % TL_AXIS_PLAN_HZ != 0U) {
        usage("--rate takes 1000, 2000, 4000, 5000, 8000 or 10000 Hz");
    }
    const size_t length = strlen(board.serial);
    if (length == 0U || length > 31U ||
        strspn(board.serial, "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-") != length) {
        usage("--serial takes at most 31 letters, digits and hyphens");
    }
    if (!board_open(&board)) {
        return 1;
    }
    usbip_init();
    uart_init();
    simlink_init(realtime);
    const int host_listener = net_listen(host_port, &host_port);
    const int sim_listener = host_listener < 0 ? -1 : net_listen(sim_port, &sim_port);
    if (sim_listener < 0) {
        fprintf(stderr, "tautline-board: cannot listen: %s: choose other ports, or 0\n", strerror(errno));
        return 1;
    }
    signal(SIGINT, stop);
    signal(SIGTERM, stop);
    signal(SIGPIPE, SIG_IGN);
    printf("{\"%s\": %d, \"sim\": %d, \"serial\": \"%s\", \"axes\": %u, \"rate\": %u}\n",
           board.on_uart ? "uart" : "usbip", host_port, sim_port, board.serial, board.axes, board.control_hz);
    fflush(stdout);
    const service_t usb = {usbip_connections, USBIP_CONNECTIONS, host_listener, usbip_closed};
    const service_t uart = {uart_connections, UART_CONNECTIONS, host_listener, uart_closed};
    const service_t sim = {simlink_connections, SIMLINK_CONNECTIONS, sim_listener, simlink_closed};
    serve(board.on_uart ? &uart : &usb, &sim, parent);
    return 0;
}
