import { ACK, NAK, STALLED, TIMEOUT } from './usb.js';

const FRAME_NANOS = 1e6;
const SLOT_NANOS = 50e3;  // one full-speed bulk transaction of 64 bytes, tokens and gaps included
const RESET_NANOS = 1e6; // 10 ms and more on a real bus; nothing in the device depends on it,
const RECOVERY_NANOS = 10e6; // but for erratum E5's work-round, which takes some of the 10 ms that every host leaves it
const SUSPEND_NANOS = 3e6;
const ADDRESS_NANOS = 2e6; // that a device may take to answer to its new address
const ADDRESS = 1;
const READ_AHEAD_ENDPOINT = 1;     // as a host program that keeps reads pending; a simulated one reads once per slice of time
const READ_AHEAD_MAX = 64 * 1024;

export const OK = 0;
export const EPIPE = -32;
export const EPROTO = -71;
export const EOVERFLOW = -75;
export const ECONNRESET = -104;
export const ESHUTDOWN = -108;

const GET_DESCRIPTOR = 6;
const SET_ADDRESS = 5;
const SET_CONFIGURATION = 9;
const CLEAR_FEATURE = 1;
const ENDPOINT_HALT = 0;

export function setupPacket(type, request, value, index, length) {
    return Uint8Array.of(type, request, value & 0xff, value >> 8, index & 0xff, index >> 8, length & 0xff, length >> 8);
}

/**
 * A full-speed host with one port: start of frame every millisecond, one transaction per endpoint and slot, retries on NAK.
 * It resets and addresses the device as soon as it shows up; configuring it is the user's business.
 *
 * A transfer is {endpoint, out, setup, data, length, done(status, data)}; `data` is sent, `length` the most to receive.
 */
export class UsbHost {
    constructor(packetSize = 64) {
        this.packetSize = packetSize;
        this.connected = true; // the cable
        this.progress = 0;     // transactions that moved something
        this.onAttached = () => {};
        this.onDetached = () => {};
        this.#forget();
    }

    #forget() {
        this.ready = false;     // addressed, descriptors read
        this.address = 0;
        this.queues = new Map(); // endpoint address -> transfers
        this.toggles = new Map();
        this.toggleErrors = 0;
        this.deviceDescriptor = null;
        this.configDescriptor = null;
        this.enumerating = false;
        this.suspended = false;
        this.ahead = [];        // packets of READ_AHEAD_ENDPOINT that nobody has asked for yet
        this.aheadBytes = 0;
        this.configured = false;
    }

    /** A chip that has just started. */
    attach(chip) {
        this.detach();
        this.chip = chip;
        this.clock = chip.clock;
        this.frameAlarm = this.clock.createAlarm(() => this.#frame());
        this.slotAlarm = this.clock.createAlarm(() => this.#slot());
        this.resetAlarm = this.clock.createAlarm(() => this.#enumerate());
        this.addressAlarm = this.clock.createAlarm(() => this.#describe());
        this.suspendAlarm = this.clock.createAlarm(() => chip.usbCtrl.suspend());
        this.frameAlarm.schedule(FRAME_NANOS);
    }

    detach() {
        const wasReady = this.ready;
        const pending = [...this.queues.values()].flat();
        this.frameAlarm?.cancel();
        this.slotAlarm?.cancel();
        this.resetAlarm?.cancel();
        this.addressAlarm?.cancel();
        this.suspendAlarm?.cancel();
        this.#forget();
        this.chip = null;
        for (const transfer of pending) this.finish(transfer, ESHUTDOWN);
        if (wasReady) this.onDetached();
    }

    plug(connected) {
        if (connected === this.connected) return;
        this.connected = connected;
        const { chip } = this;
        if (chip === null) return;
        this.detach();
        this.attach(chip);
        if (!connected) this.suspend();
    }

    get attached() {
        return this.connected && this.chip !== null && this.chip.usbCtrl.attached;
    }

    /** Whether something is on its way to the device: data, or a control transfer. */
    get sending() {
        for (const key of this.queues.keys()) if (!(key & 0x80)) return true;
        return false;
    }

    /** Starts over with the device that is there: bus reset, address, descriptors. */
    reset() {
        const { chip } = this;
        this.detach();
        this.attach(chip);
        this.#frame();
    }

    /** No more frames: the device notices after 3 ms. Until reset(). */
    suspend() {
        if (this.chip === null || this.suspended) return;
        this.suspended = true;
        this.frameAlarm.cancel();
        this.suspendAlarm.schedule(SUSPEND_NANOS);
    }

    #frame() {
        if (!this.connected || this.suspended) return;
        this.frameAlarm.schedule(FRAME_NANOS);
        if (this.attached && !this.enumerating) {
            this.enumerating = true;
            this.chip.usbCtrl.busReset();
            this.resetAlarm.schedule(this.chip.hasE5 ? RECOVERY_NANOS : RESET_NANOS);
        } else if (!this.attached && this.enumerating) { // the firmware let go of the bus
            const { chip } = this;
            this.detach();
            this.attach(chip);
        } else if (this.enumerating) {
            this.chip.usbCtrl.startOfFrame();
        }
    }

    /** Without promises, so that a deterministic run never waits for the event loop. */
    #sequence(steps) {
        const [step, ...rest] = steps;
        if (!step) return;
        const setup = step.setup();
        this.submit({ endpoint: 0, out: !(setup[0] & 0x80), setup, data: new Uint8Array(0), length: setup[6] | (setup[7] << 8),
            done: (status, data) => {
                if (status === OK) {
                    step.then(data);
                    this.#sequence(rest);
                }
            } });
    }

    #enumerate() {
        this.#sequence([{ setup: () => setupPacket(0, SET_ADDRESS, ADDRESS, 0, 0), then: () => {
            this.address = ADDRESS;
            this.addressAlarm.schedule(ADDRESS_NANOS);
        } }]);
    }

    #describe() {
        const descriptor = (kind, length) => setupPacket(0x80, GET_DESCRIPTOR, kind << 8, 0, length);
        this.#sequence([
            { setup: () => descriptor(1, 18), then: (data) => { this.deviceDescriptor = data; } },
            { setup: () => descriptor(2, 9), then: (data) => { this.configDescriptor = data; } },
            { setup: () => descriptor(2, this.configDescriptor[2] | (this.configDescriptor[3] << 8)),
                then: (data) => {
                    this.configDescriptor = data;
                    this.ready = true;
                    this.onAttached();
                } },
        ]);
    }

    submit(transfer) {
        transfer.moved = 0;
        transfer.received = [];
        if (!this.attached) {
            this.finish(transfer, ESHUTDOWN);
            return;
        }
        const key = transfer.setup ? 0 : transfer.endpoint | (transfer.out ? 0 : 0x80);
        transfer.stage = transfer.setup ? 'setup' : 'data';
        while (key === (READ_AHEAD_ENDPOINT | 0x80) && this.ahead.length > 0 && !this.queues.has(key)) {
            const packet = this.ahead.shift();
            this.aheadBytes -= packet.length;
            const status = this.#receive(transfer, packet);
            if (status !== null) {
                this.finish(transfer, status);
                return;
            }
        }
        if (!this.queues.has(key)) this.queues.set(key, []);
        this.queues.get(key).push(transfer);
        if (!this.slotAlarm.scheduled) this.slotAlarm.schedule(SLOT_NANOS);
    }

    /** Takes a transfer back; false: it is done already. */
    cancel(transfer) {
        for (const [key, queue] of this.queues) {
            const at = queue.indexOf(transfer);
            if (at >= 0) {
                queue.splice(at, 1);
                if (queue.length === 0) this.queues.delete(key);
                return true;
            }
        }
        return false;
    }

    #slot() {
        this.slotAlarm.scheduled = false;
        for (const [key, queue] of [...this.queues]) {
            const transfer = queue[0];
            const moved = transfer.moved;
            const { stage } = transfer;
            const status = this.#transact(key, transfer);
            if (status !== null || transfer.moved !== moved || transfer.stage !== stage) this.progress += 1;
            if (status !== null) {
                queue.shift();
                if (queue.length === 0) this.queues.delete(key);
                this.finish(transfer, status);
            }
        }
        this.#readAhead();
        if ((this.queues.size > 0 || this.configured) && !this.slotAlarm.scheduled) this.slotAlarm.schedule(SLOT_NANOS);
    }

    #readAhead() {
        const key = READ_AHEAD_ENDPOINT | 0x80;
        if (!this.configured || this.suspended || this.queues.has(key) || this.aheadBytes > READ_AHEAD_MAX) return;
        const toggle = this.toggles.get(key) ?? 0;
        const answer = this.#in(READ_AHEAD_ENDPOINT, toggle);
        if (typeof answer === 'string') return;
        this.toggles.set(key, toggle ^ 1);
        this.ahead.push(answer.data);
        this.aheadBytes += answer.data.length;
    }

    /** Hands over what was received. */
    finish(transfer, status) {
        const data = new Uint8Array(transfer.received.reduce((sum, part) => sum + part.length, 0));
        let at = 0;
        for (const part of transfer.received) {
            data.set(part, at);
            at += part.length;
        }
        if (transfer.setup && status === OK) this.#sideEffects(transfer.setup);
        transfer.done(status, transfer.out ? new Uint8Array(0) : data, transfer.moved);
    }

    /** What a request changes on the host's side. */
    #sideEffects([type, request, valueLow, , indexLow]) {
        if (type === 0 && request === SET_CONFIGURATION) {
            this.toggles.clear();
            this.ahead = [];
            this.aheadBytes = 0;
            this.configured = valueLow !== 0;
        }
        if (type === 2 && request === CLEAR_FEATURE && valueLow === ENDPOINT_HALT) this.toggles.delete(indexLow);
    }

    #in(endpoint, toggle) {
        const answer = this.chip.usbCtrl.in(this.address, endpoint);
        if (typeof answer === 'object' && answer.toggle !== toggle) {
            this.toggleErrors += 1;
            return NAK; // the host drops it and asks again
        }
        return answer;
    }

    /** One transaction; null while the transfer goes on. */
    #transact(key, transfer) {
        const usb = this.chip.usbCtrl;
        if (transfer.setup) return this.#transactControl(usb, transfer);
        const toggle = this.toggles.get(key) ?? 0;
        if (transfer.out) {
            const packet = transfer.data.subarray(transfer.moved, transfer.moved + this.packetSize);
            const answer = usb.out(this.address, transfer.endpoint, toggle, packet);
            if (answer === ACK) {
                this.toggles.set(key, toggle ^ 1);
                transfer.moved += packet.length;
                const zero = transfer.zeroPacket && packet.length === this.packetSize;
                return transfer.moved === transfer.data.length && !zero ? OK : null;
            }
            return handshake(answer);
        }
        const answer = this.#in(transfer.endpoint, toggle);
        if (typeof answer === 'string') return handshake(answer);
        this.toggles.set(key, toggle ^ 1);
        return this.#receive(transfer, answer.data);
    }

    #receive(transfer, data) {
        if (transfer.moved + data.length > transfer.length) return EOVERFLOW;
        transfer.received.push(data);
        transfer.moved += data.length;
        return data.length < this.packetSize || transfer.moved === transfer.length ? OK : null;
    }

    #transactControl(usb, transfer) {
        const { setup } = transfer;
        const length = setup[6] | (setup[7] << 8);
        if (transfer.stage === 'setup') {
            const answer = usb.setup(this.address, setup);
            if (answer !== ACK) return handshake(answer);
            transfer.toggle = 1;
            transfer.stage = length > 0 ? 'data' : 'status';
            return null;
        }
        if (transfer.stage === 'data' && !transfer.out) {
            const answer = this.#in(0, transfer.toggle);
            if (typeof answer === 'string') return handshake(answer);
            transfer.toggle ^= 1;
            const status = this.#receive(transfer, answer.data);
            if (status === OK) transfer.stage = 'status';
            return status === OK ? null : status;
        }
        if (transfer.stage === 'data') {
            const packet = transfer.data.subarray(transfer.moved, transfer.moved + this.packetSize);
            const answer = usb.out(this.address, 0, transfer.toggle, packet);
            if (answer !== ACK) return handshake(answer);
            transfer.toggle ^= 1;
            transfer.moved += packet.length;
            if (transfer.moved === transfer.data.length) transfer.stage = 'status';
            return null;
        }
        if (transfer.out || length === 0) { // status IN
            const answer = this.#in(0, 1);
            return typeof answer === 'string' ? handshake(answer) : OK;
        }
        const answer = usb.out(this.address, 0, 1, new Uint8Array(0));
        return answer === ACK ? OK : handshake(answer);
    }
}

function handshake(answer) {
    return { [NAK]: null, [STALLED]: EPIPE, [TIMEOUT]: EPROTO }[answer];
}
