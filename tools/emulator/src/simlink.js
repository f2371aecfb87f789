import net from 'node:net';

const ADVANCE_MAX_US = 10000000;
const SLICE_US = 1000;
const TURN_US = 4000; // of the wall clock, after which USB and sockets have theirs
const LAG_US = 20000;
const AXES = 4;
const ILLS = ['well', 'blocked', 'unplugged', 'reversed', 'coarse', 'driver', 'supply', 'estop']; // no jump: no encoder's edges do
const HELP = 'not a request: advance US, state, realtime on|off, cut N, place AXIS Q8, inject AXIS ILL, unplug, plug, reset, hang, ' +
    'halt, crash hardfault|nmi|panic, locks, quit';

const wallUs = () => Number(process.hrtime.bigint() / 1000n);

/** The sim link as the desktop board serves it (docs/protocol.md): one text request a line, one JSON object a line back. */
export class SimLink {
    /** The world's time is what was granted; the board itself may be ahead of it, see UsbIpServer.settle. */
    constructor(board, usbip, { realtime = false, startUs = 0 } = {}) {
        this.board = board;
        this.usbip = usbip;
        this.grantedUs = startUs;
        this.told = Math.floor(startUs / 1000);
        this.clients = new Set();
        this.onQuit = () => {};
        this.server = net.createServer((socket) => this.#accept(socket));
        this.#pace(realtime);
    }

    listen(port) {
        return new Promise((resolve, reject) => {
            this.server.once('error', reject);
            this.server.listen(port, '127.0.0.1', () => resolve(this.server.address().port));
        });
    }

    #accept(socket) {
        socket.setNoDelay(true);
        let text = '';
        socket.on('error', () => socket.destroy());
        socket.on('data', (data) => {
            text += data.toString('latin1');
            let end;
            while ((end = text.indexOf('\n')) >= 0) {
                const line = text.slice(0, end).trim();
                text = text.slice(end + 1);
                socket.write(`${JSON.stringify(this.request(line))}\n`);
            }
        });
    }

    /**
     * With `realtime` the wall clock grants the time. Where the machine is too slow for that the board's time falls behind,
     * and does not hurry later: whoever talks to it meets a clock that is slow, not one that jumps.
     */
    #pace(on) {
        this.realtime = on;
        clearTimeout(this.timer);
        if (!on) return;
        let start = wallUs() - this.grantedUs;
        const tick = () => {
            const began = wallUs();
            let due = began - start;
            while (this.grantedUs < due && wallUs() - began < TURN_US) {
                this.#grant(Math.min(due - this.grantedUs, SLICE_US));
                due = wallUs() - start;
            }
            start += Math.max(due - this.grantedUs - LAG_US, 0);
            this.timer = setTimeout(tick, 1);
        };
        tick();
    }

    #grant(us) {
        this.grantedUs += us;
        this.board.run(this.grantedUs);
    }

    #advance(us) {
        this.#grant(us);
        this.usbip.settle();
        const rows = this.board.plant.log.slice(this.told, Math.floor(this.grantedUs / 1000));
        const from = this.told + 1;
        this.told += rows.length;
        return { t_us: this.grantedUs, from_us: from * 1000, dt_us: 1000,
            q: Array.from({ length: AXES }, (_, axis) => rows.map((row) => row[axis])) };
    }

    /** `q` is the world's, at t_us; `axes` are as the board, which may be ahead of that, has them at `axes_us` of its own time. */
    #state() {
        const { board } = this;
        return {
            t_us: this.grantedUs, board_us: this.grantedUs - board.bootUs, powered: board.powered,
            bootloader: board.bootloader, hung: board.hung, attached: this.usbip.attached, realtime: this.realtime,
            starts: board.starts, flash_operations: board.flash.operations,
            q: board.plant.log[Math.floor(this.grantedUs / 1000) - 1],
            axes_us: Math.floor(Math.max(board.nowUs, this.grantedUs) - board.bootUs),
            axes: Array.from({ length: AXES }, (_, axis) => ({
                duty_q15: Math.round(board.plant.duty(axis) * 32768), true_q8: board.plant.trueQ8(axis), ...board.axis(axis),
            })),
        };
    }

    request(line) {
        const [verb, ...words] = line.split(' ');
        const numbers = words.map(Number);
        const whole = (count, least, most) => words.length === count &&
            numbers.every((n, i) => words[i] !== '' && Number.isInteger(n) && n >= least && n <= most);
        const ok = () => ({ t_us: this.grantedUs });
        switch (verb) {
            case 'advance':
                if (!whole(1, 0, ADVANCE_MAX_US)) return { error: `advance takes 0 to ${ADVANCE_MAX_US} microseconds` };
                return this.#advance(numbers[0]);
            case 'state':
                return this.#state();
            case 'realtime':
                if (words[0] !== 'on' && words[0] !== 'off') break;
                this.#pace(words[0] === 'on');
                return ok();
            case 'cut':
                if (!whole(1, 0, 1000000)) break;
                this.board.cut(numbers[0]);
                return ok();
            case 'place':
                if (!whole(2, -1e9, 1e9) || numbers[0] < 0 || numbers[0] >= AXES) {
                    return { error: 'place takes an axis and a position in counts Q8' };
                }
                this.board.plant.place(numbers[0], numbers[1]);
                return ok();
            case 'inject':
                if (words.length !== 2 || !(Number(words[0]) in this.board.plant.motors) || !ILLS.includes(words[1])) {
                    return { error: `inject takes an axis and ${ILLS.join(', ')}` };
                }
                this.board.plant.inject(Number(words[0]), words[1]);
                return { ...ok(), ills: this.board.plant.ills };
            case 'unplug':
                this.usbip.plug(false);
                this.board.usb.plug(false);
                return ok();
            case 'plug':
                this.board.usb.plug(true);
                this.usbip.plug(true);
                return ok();
            case 'reset':
                this.board.reset();
                return ok();
            case 'hang':
                this.board.hang();
                return ok();
            case 'halt':
                this.board.halt();
                return ok();
            case 'crash':
                if (!['hardfault', 'nmi', 'panic'].includes(words[0])) break;
                return this.board.crash(words[0]);
            case 'locks':
                return this.board.locks();
            case 'quit':
                setImmediate(() => this.onQuit());
                return ok();
        }
        return { error: HELP };
    }
}
