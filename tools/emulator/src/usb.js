import { RPUSBController } from './rp2040js.js';

const EP_CONTROL = 0x08;     // of EP1 IN; then EP1 OUT, EP2 IN, ...
const BUFFER_CONTROL = 0x80; // of EP0 IN; then EP0 OUT, EP1 IN, ...
const EP0_BUFFER = 0x100;
const BUFFER1_OFFSET = 64;

const EP_ENABLE = 1 << 31;
const EP_DOUBLE_BUFFERED = 1 << 30;
const EP_INTERRUPT_PER_DOUBLE = 1 << 28;

// One half of a buffer control register.
const LENGTH = 0x3ff;
const AVAILABLE = 1 << 10;
const STALL = 1 << 11;
const RESET_SELECT = 1 << 12;
const DATA1 = 1 << 13;
const FULL = 1 << 15;

const SOF_RD = 0x48;
const EP_ABORT = 0x60;
const SIE_PULLUP = 1 << 16;
const SIE_DATA_SEQ_ERROR = 1 << 31;
const SIE_SUSPENDED = 1 << 4;
const SIE_STATUS = 0x50;
const SIE_BUS_RESET = 1 << 19;
const SIE_SETUP_RECEIVED = 1 << 17;
const INTR_SOF = 1 << 17;

const MUXING = 0x74;
const PHY_DIRECT = 0x7c;
const PHY_DIRECT_OVERRIDE = 0x80;
const TO_PHY = 1 << 0;
const TO_DIGITAL_PAD = 1 << 2;
const E5_J_NANOS = 800e3; // of J that a chip with erratum E5 wants to see on the bus after a reset
const DP_PIN = 15;        // that the digital pad's D+ is
const DP_FUNCTION = 8;
const INOVER_HIGH = 3;

export const ACK = 'ack';
export const NAK = 'nak';
export const STALLED = 'stall';
export const TIMEOUT = 'timeout'; // nobody answers: not attached, another address, endpoint not enabled

/**
 * The device side of the controller, one token at a time as a host sends them. rp2040js moves whole buffers as soon as the
 * firmware offers them: no NAK, no STALL, no toggles, no SOF, and a double-buffered IN in the wrong order.
 *
 * A chip with erratum RP2040-E5 is on a busy hub here: other devices' packets leave it no J after a reset, and it hears
 * nothing until the firmware has shown it one on the digital pads.
 */
export class UsbController extends RPUSBController {
    constructor(rp2040, name) {
        super(rp2040, name);
        this.select = new Uint8Array(32); // which half a double-buffered endpoint uses next; index as in BUFF_STATUS
        this.toggleErrors = 0;
        this.phy = new Map([[MUXING, 0], [PHY_DIRECT, 0], [PHY_DIRECT_OVERRIDE, 0]]);
        this.deaf = false;
        this.shownJ = 0; // since when, ns
    }

    get attached() {
        return (this.sieCtrl & SIE_PULLUP) !== 0;
    }

    /** The firmware wrote a word of the dual-port memory; the controller itself reads it when a token comes. */
    DPRAMUpdated(offset, value) {
        if (offset >= BUFFER_CONTROL && offset < EP0_BUFFER && value & RESET_SELECT) {
            this.select[(offset - BUFFER_CONTROL) >> 2] = 0;
        }
    }

    readUint32(offset) {
        if (this.phy.has(offset)) return this.phy.get(offset);
        const value = super.readUint32(offset);
        if (offset === SOF_RD && this.intRaw & INTR_SOF) {
            this.intRaw &= ~INTR_SOF;
            this.checkInterrupts();
        }
        return value;
    }

    writeUint32(offset, value) {
        if (offset === SIE_STATUS) this.sieStatus &= ~(this.rawWriteValue & SIE_SUSPENDED);
        if (this.phy.has(offset)) {
            this.phy.set(offset, value);
            if (offset === MUXING) this.#mux(value);
            if (offset !== MUXING) return;
        }
        super.writeUint32(offset, value);
        if (offset === EP_ABORT) {
            this.epAbortDone &= value; // done as soon as asked, gone with the request
        }
    }

    #mux(value) {
        const { ctrl } = this.rp2040.gpio[DP_PIN];
        const showsJ = (ctrl & 0x1f) === DP_FUNCTION && ((ctrl >>> 16) & 3) === INOVER_HIGH;
        const now = this.rp2040.clock.nanos;
        if (value & TO_DIGITAL_PAD && !(value & TO_PHY) && showsJ) {
            this.shownJ = now;
        } else if (value & TO_PHY && this.shownJ > 0) {
            this.deaf = this.deaf && now - this.shownJ < E5_J_NANOS;
            this.shownJ = 0;
        }
    }

    busReset() {
        this.deaf = this.rp2040.hasE5;
        this.addrEndp = 0;
        this.sieStatus |= SIE_BUS_RESET;
        this.sieStatusUpdated();
    }

    /** The bus has been idle for 3 ms. */
    suspend() {
        this.sieStatus |= SIE_SUSPENDED;
        this.sieStatusUpdated();
    }

    startOfFrame() {
        this.sofFrameNumber = (this.sofFrameNumber + 1) & 0x7ff;
        this.intRaw |= INTR_SOF;
        this.checkInterrupts();
    }

    #answers(address) {
        return this.attached && !this.deaf && (this.addrEndp & 0x7f) === address;
    }

    setup(address, packet) {
        if (!this.#answers(address)) {
            return TIMEOUT;
        }
        this.rp2040.usbDPRAM.set(packet, 0);
        this.epStallArm = 0;
        this.sieStatus |= SIE_SETUP_RECEIVED;
        this.sieStatusUpdated();
        return ACK;
    }

    /** What the endpoint has to say: {half, shift, index, buffer, control}, or a handshake. */
    #endpoint(address, endpoint, out) {
        if (!this.#answers(address)) {
            return TIMEOUT;
        }
        const index = endpoint * 2 + (out ? 1 : 0);
        const view = this.rp2040.usbDPRAMView;
        let control = 0;
        let buffer = EP0_BUFFER;
        if (endpoint > 0) {
            control = view.getUint32(EP_CONTROL + (index - 2) * 4, true);
            if (!(control & EP_ENABLE)) {
                return TIMEOUT;
            }
            buffer = control & 0xffc0;
        }
        if (this.epAbort & (1 << index)) return NAK; // the buffer is being taken back
        const value = view.getUint32(BUFFER_CONTROL + index * 4, true);
        if (value & STALL && (endpoint > 0 || this.epStallArm & (out ? 2 : 1))) {
            return STALLED;
        }
        const second = control & EP_DOUBLE_BUFFERED ? this.select[index] : 0;
        const shift = second * 16;
        const half = (value >>> shift) & 0xffff;
        if (!(half & AVAILABLE) || !(half & FULL) === !out) {
            return NAK;
        }
        return { half, shift, index, buffer: buffer + second * BUFFER1_OFFSET, control };
    }

    #release({ shift, index, control }, half) {
        const view = this.rp2040.usbDPRAMView;
        const at = BUFFER_CONTROL + index * 4;
        const value = view.getUint32(at, true);
        view.setUint32(at, (value & ~(0xffff << shift)) | (half << shift), true);
        let signal = true;
        if (control & EP_DOUBLE_BUFFERED) {
            signal = shift > 0 || !(control & EP_INTERRUPT_PER_DOUBLE);
            this.select[index] ^= 1;
        }
        if (signal) {
            this.buffStatus |= 1 << index;
            this.buffStatusUpdated();
        }
    }

    /** IN token: {data, toggle} or a handshake; the host acknowledges the data. */
    in(address, number) {
        const endpoint = this.#endpoint(address, number, false);
        if (typeof endpoint === 'string') {
            return endpoint;
        }
        const { half, buffer } = endpoint;
        const data = this.rp2040.usbDPRAM.slice(buffer, buffer + (half & LENGTH));
        this.#release(endpoint, half & ~(AVAILABLE | FULL));
        return { data, toggle: half & DATA1 ? 1 : 0 };
    }

    /** OUT token with its data packet: a handshake. */
    out(address, number, toggle, data) {
        const endpoint = this.#endpoint(address, number, true);
        if (typeof endpoint === 'string') {
            return endpoint;
        }
        const { half, buffer } = endpoint;
        if ((half & DATA1 ? 1 : 0) !== toggle) { // taken for a repetition: acknowledged and dropped
            this.toggleErrors += 1;
            this.sieStatus |= SIE_DATA_SEQ_ERROR;
            this.sieStatusUpdated();
            return ACK;
        }
        const length = Math.min(data.length, half & LENGTH);
        this.rp2040.usbDPRAM.set(data.subarray(0, length), buffer);
        this.#release(endpoint, (half & ~(AVAILABLE | LENGTH)) | FULL | length);
        return ACK;
    }
}
