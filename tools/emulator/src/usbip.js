import net from 'node:net';

import { OK, ESHUTDOWN } from './usbhost.js';

const VERSION = 0x0111;
const OP_REQ_DEVLIST = 0x8005;
const OP_REQ_IMPORT = 0x8003;
const REPLY = 0x7fff;
const CMD_SUBMIT = 1;
const CMD_UNLINK = 2;
const RET_SUBMIT = 3;
const RET_UNLINK = 4;
const STATUS_BUSY = 2;
const STATUS_NO_DEVICE = 4;
const BUS_ID = '1-1';
const SPEED_FULL = 2;
const HEADER = 48;
const TRANSFER_MAX = 64 * 1024;
const ZERO_PACKET = 0x40; // transfer flag
const EMSGSIZE = -90;
const ECONNRESET = -104;
const SET_ADDRESS = 5;
const IDLE_US = 1100;     // TinyUSB holds packets back in the last 0.2 ms of a frame (erratum 15), until the next one begins
const PATIENCE_US = 1e6;  // with a board that takes nothing and never rests

/** USB/IP: one device, one host at a time, as the desktop board serves it. */
export class UsbIpServer {
    constructor(board) {
        this.board = board;
        this.importer = null;
        this.urbs = new Map(); // sequence number -> transfer
        this.plugged = true;
        this.server = net.createServer((socket) => this.#accept(socket));
        board.onReset = () => this.#drop();
    }

    listen(port) {
        return new Promise((resolve, reject) => {
            this.server.once('error', reject);
            this.server.listen(port, '127.0.0.1', () => resolve(this.server.address().port));
        });
    }

    get attached() {
        return this.importer !== null;
    }

    plug(on) {
        this.plugged = on;
        if (!on) this.#drop();
    }

    #drop() {
        this.importer?.end();
        this.#release();
    }

    #release() {
        if (this.importer === null) return;
        this.importer = null;
        for (const transfer of this.urbs.values()) this.board.usb.cancel(transfer);
        this.urbs.clear();
        this.board.usb.suspend();
    }

    #accept(socket) {
        socket.setNoDelay(true);
        let input = Buffer.alloc(0);
        socket.on('data', (data) => {
            input = Buffer.concat([input, data]);
            for (;;) {
                const taken = socket === this.importer ? this.#command(input) : this.#operation(socket, input);
                if (taken === 0) break;
                input = input.subarray(taken);
            }
            if (socket === this.importer) this.settle();
        });
        const closed = () => {
            if (socket === this.importer) this.#release();
        };
        socket.on('close', closed);
        socket.on('error', closed);
    }

    // -- before an import ---------------------------------------------------------------------------------------------

    #reply(socket, code, status, ...parts) {
        const head = Buffer.alloc(8);
        head.writeUInt16BE(VERSION, 0);
        head.writeUInt16BE(code & REPLY, 2);
        head.writeUInt32BE(status, 4);
        socket.write(Buffer.concat([head, ...parts]));
    }

    #device() {
        const { deviceDescriptor: device, configDescriptor: config } = this.board.usb;
        const entry = Buffer.alloc(312);
        entry.write(`/sys/devices/tautline/usb1/${BUS_ID}`, 0);
        entry.write(BUS_ID, 256);
        entry.writeUInt32BE(1, 288);
        entry.writeUInt32BE(2, 292);
        entry.writeUInt32BE(SPEED_FULL, 296);
        entry.writeUInt16BE(device[8] | (device[9] << 8), 300);
        entry.writeUInt16BE(device[10] | (device[11] << 8), 302);
        entry.writeUInt16BE(device[12] | (device[13] << 8), 304);
        entry.set([device[4], device[5], device[6], 1, device[17], config[4]], 306);
        return entry;
    }

    #interfaces() {
        const { configDescriptor: config } = this.board.usb;
        const found = [];
        for (let at = 0; at < config.length; at += config[at]) {
            if (config[at + 1] === 4 && config[at + 3] === 0) found.push(config[at + 5], config[at + 6], config[at + 7], 0);
        }
        return Buffer.from(found);
    }

    get #available() {
        return this.plugged && this.board.chip !== null && this.board.waitForUsb();
    }

    #operation(socket, input) {
        if (input.length < 8) return 0;
        const code = input.readUInt16BE(2);
        if (code === OP_REQ_DEVLIST) {
            const count = Buffer.alloc(4);
            if (this.#available) {
                count[3] = 1;
                this.#reply(socket, code, 0, count, this.#device(), this.#interfaces());
            } else {
                this.#reply(socket, code, 0, count);
            }
            socket.end();
            return 8;
        }
        if (code === OP_REQ_IMPORT) {
            if (input.length < 40) return 0;
            const id = input.subarray(8, 40).toString('latin1').replace(/\0.*$/s, '');
            if (this.importer !== null) {
                this.#reply(socket, code, STATUS_BUSY);
                socket.end();
            } else if (id !== BUS_ID || !this.#available) {
                this.#reply(socket, code, STATUS_NO_DEVICE);
                socket.end();
            } else {
                this.board.usb.reset();
                if (this.board.waitForUsb()) {
                    this.importer = socket;
                    this.#reply(socket, code, 0, this.#device());
                } else {
                    this.#reply(socket, code, STATUS_NO_DEVICE);
                    socket.end();
                }
            }
            return 40;
        }
        socket.destroy(); // not USB/IP
        return input.length;
    }

    // -- transfers ----------------------------------------------------------------------------------------------------

    #return(kind, sequence, status, actual = 0, data = null) {
        const header = Buffer.alloc(HEADER);
        header.writeUInt32BE(kind, 0);
        header.writeUInt32BE(sequence, 4);
        header.writeInt32BE(status, 20);
        header.writeUInt32BE(actual, 24);
        this.importer?.write(data !== null && data.length > 0 ? Buffer.concat([header, data]) : header);
    }

    #command(input) {
        if (input.length < HEADER) return 0;
        const kind = input.readUInt32BE(0);
        const sequence = input.readUInt32BE(4);
        if (kind === CMD_UNLINK) {
            const target = input.readUInt32BE(20);
            const transfer = this.urbs.get(target);
            const found = transfer !== undefined && this.board.usb.cancel(transfer);
            // What came before a host's time-out counts: a transfer that has data ends with it.
            const partial = found && !transfer.out && transfer.moved > 0;
            if (partial) this.board.usb.finish(transfer, OK);
            this.urbs.delete(target);
            this.#return(RET_UNLINK, sequence, found && !partial ? ECONNRESET : 0);
            return HEADER;
        }
        if (kind !== CMD_SUBMIT) {
            this.importer.destroy();
            return input.length;
        }
        const out = input.readUInt32BE(12) === 0;
        const length = input.readUInt32BE(24);
        const size = HEADER + (out ? length : 0);
        if (input.length < size) return 0;
        if (length > TRANSFER_MAX) this.#return(RET_SUBMIT, sequence, EMSGSIZE);
        else this.#submit(sequence, input, out, length);
        return size;
    }

    #submit(sequence, input, out, length) {
        const endpoint = input.readUInt32BE(16);
        const setup = endpoint === 0 ? Uint8Array.from(input.subarray(40, 48)) : null;
        if (setup !== null && setup[0] === 0 && setup[1] === SET_ADDRESS) { // the server's business, done already
            this.#return(RET_SUBMIT, sequence, OK);
            return;
        }
        const transfer = {
            endpoint, out, setup, length,
            data: out ? Uint8Array.from(input.subarray(HEADER, HEADER + length)) : new Uint8Array(0),
            zeroPacket: (input.readUInt32BE(20) & ZERO_PACKET) !== 0,
            done: (status, data, actual) => {
                if (!this.urbs.delete(sequence)) return;
                this.#return(RET_SUBMIT, sequence, status === ESHUTDOWN ? ESHUTDOWN : status, out ? actual ?? 0 : data.length, data);
            },
        };
        this.urbs.set(sequence, transfer);
        this.board.usb.submit(transfer);
    }

    /**
     * While time stands still a host expects answers all the same: the board runs ahead, as long as something is on its way
     * to it and then until its main loop has nothing to do and nothing to say. What it ran ahead is taken from the next time
     * that is granted.
     */
    settle() {
        const { board } = this;
        let { progress } = board.usb;
        let since = board.nowUs;
        let { sleeps } = board.chip?.core ?? {};
        const { chip } = board;
        while (board.chip === chip && chip !== null && this.importer !== null && board.nowUs - since < PATIENCE_US) {
            if (board.usb.progress !== progress) {
                progress = board.usb.progress;
                since = board.nowUs;
                sleeps = chip.core.sleeps;
            }
            const idle = chip.core.sleeps > sleeps + 1 && board.nowUs - since > IDLE_US;
            if (idle && !board.usb.sending) break;
            board.run(board.nowUs + 20);
        }
    }
}
