import { BasePeripheral, RPPADS, RPPWM, RPTimer, RPWatchdog } from './rp2040js.js';

/** A block whose registers only have to remember what was written. */
export class Registers extends BasePeripheral {
    constructor(rp2040, name, initial = {}) {
        super(rp2040, name);
        this.values = new Map(Object.entries(initial).map(([offset, value]) => [Number(offset), value]));
    }
    readUint32(offset) {
        return this.values.get(offset) ?? 0;
    }
    writeUint32(offset, value) {
        this.values.set(offset, value >>> 0);
    }
}

/** Pads: one whose input goes on lets the state machines see what drives it since before. */
export class Pads extends RPPADS {
    writeUint32(offset, value) {
        this.rp2040.changeInputs(() => super.writeUint32(offset, value));
    }
}

const SSIENR = 0x08;
const SR = 0x28;
const IDR = 0x58;
const VERSION = 0x5c;
const DR0 = 0x60;
const SPI_CTRLR0 = 0xf4;
const SR_READY = 0x06;     // transmit FIFO empty and not full, not busy
const SR_RECEIVED = 0x08;
const QUAD_CONTINUOUS = 0xa0; // XIP_CMD once the second stage has set the chip up for execution in place

const READ_ID = 0x4b;
const READ_STATUS1 = 0x05;
const READ_STATUS2 = 0x35;
const QUAD_ENABLED = 0x02;

/** The serial flash controller as the SDK uses it: single bytes to the flash chip, and the step back to execution in place. */
export class Ssi extends Registers {
    constructor(rp2040) {
        super(rp2040, 'SSI', { [SSIENR]: 0, [IDR]: 0x51535049, [VERSION]: 0x3430312a });
        this.received = [];
        this.command = -1; // of the transaction under way
        this.index = 0;
    }

    /** Chip select went high: the next byte is a command. */
    deselect() {
        this.command = -1;
    }

    #shift(byte) {
        if (this.command < 0) {
            this.command = byte;
            this.index = 0;
            return 0;
        }
        this.index += 1;
        switch (this.command) {
            case READ_ID: // four dummy bytes, then the id
                return this.rp2040.flashChip.id[this.index - 5] ?? 0;
            case READ_STATUS2:
                return QUAD_ENABLED;
            default:
                return 0;
        }
    }

    readUint32(offset) {
        switch (offset) {
            case SR:
                return SR_READY | (this.received.length > 0 ? SR_RECEIVED : 0);
            case DR0:
                return this.received.shift() ?? 0;
            default:
                return super.readUint32(offset);
        }
    }

    writeUint32(offset, value) {
        if (offset === DR0) {
            this.received.push(this.#shift(value & 0xff));
            // The second stage frames its two-byte transactions by the FIFO running empty.
            if (!this.rp2040.chipSelectForced && this.index > 0) this.deselect();
            return;
        }
        super.writeUint32(offset, value);
        if (offset === SSIENR) {
            this.received = [];
            this.deselect();
            if (value & 1 && (this.values.get(SPI_CTRLR0) ?? 0) >>> 24 === QUAD_CONTINUOUS) {
                this.rp2040.xip = true;
            }
        }
    }
}

const QSPI_SS_CTRL = 0x0c;
const OUTOVER_LOW = 2;

/** IO_QSPI: the chip select that flash_do_cmd drives by hand. */
export class IoQspi extends Registers {
    constructor(rp2040) {
        super(rp2040, 'IO_QSPI');
    }
    writeUint32(offset, value) {
        super.writeUint32(offset, value);
        if (offset === QSPI_SS_CTRL) {
            this.rp2040.chipSelectForced = ((value >>> 8) & 3) === OUTOVER_LOW;
            this.rp2040.ssi.deselect();
        }
    }
}

const ALARM0 = 0x10;
const ALARM3 = 0x1c;

/** rp2040js's alarms fire up to a microsecond before the timer shows their time; these do not. */
export class Timer extends RPTimer {
    writeUint32(offset, value) {
        super.writeUint32(offset, value);
        if (offset >= ALARM0 && offset <= ALARM3) {
            const now = this.clock.nanos;
            const micros = Math.floor(now / 1000);
            const wait = (value - micros) >>> 0;
            this.alarms[(offset - ALARM0) >> 2].clockAlarm.schedule((micros + wait) * 1000 - now);
        }
    }
}

/** Bites once, and then stops: rp2040js's timer runs on and bites again; and stands while a debugger holds the core, where it is told to. */
export class Watchdog extends RPWatchdog {
    constructor(rp2040, name) {
        super(rp2040, name);
        this.onBite = () => {};
        this.onWatchdogTrigger = () => {
            this.timer.enable = false;
            this.alarm.enable = false;
            this.onBite();
        };
    }

    /** A debugger holds the core from now on. */
    halted() {
        if (this.pauseDbg0 || this.pauseDbg1 || this.pauseJtag) {
            this.timer.enable = false;
            this.alarm.enable = false;
        }
    }
}

const CHANNEL_SIZE = 0x14;
const EN = 0xa0;
const CSR = 0x00;
const DIV = 0x04;
const CTR = 0x08;
const CC = 0x0c;
const TOP = 0x10;
const CSR_EN = 1;
const CSR_A_INV = 1 << 2;
const CSR_B_INV = 1 << 3;
const UNUSED = 0xa4; // interrupts and DMA requests at the wrap

/**
 * PWM as a motor sees it: the duty of a pin at a time, from the latched registers. rp2040js makes an event of every edge,
 * hundreds of thousands a second. Free-running, trailing edge; interrupts and phase-correct mode are refused.
 */
export class Pwm extends RPPWM {
    constructor(rp2040, name) {
        super(rp2040, name);
        for (const channel of this.channels) {
            channel.timer.enable = false; // none of rp2040js's events
            channel.alarmA.enable = channel.alarmB.enable = channel.alarmBottom.enable = false;
        }
        this.slices = Array.from({ length: 8 }, () => ({
            csr: 0, div: 16, cc: 0, top: 0xffff, start: 0, counter: 0, latched: { cc: 0, top: 0xffff }, writtenAt: 0,
        }));
    }

    reset() {}

    #period(slice) {
        return (((slice.latched.top + 1) * (slice.div || 4096)) / 16 / this.rp2040.clkSys) * 1e9;
    }

    /** When the period began in which the counter is at slice.counter now. */
    #startOf(slice) {
        return this.rp2040.clock.nanos - (slice.counter / (slice.latched.top + 1)) * this.#period(slice);
    }

    #counter(slice) {
        const period = this.#period(slice);
        const phase = ((this.rp2040.clock.nanos - slice.start) % period) / period;
        return Math.floor(phase * (slice.latched.top + 1));
    }

    /** What was written takes effect when the counter wraps. */
    #latch(slice) {
        const { latched } = slice;
        if (latched.cc === slice.cc && latched.top === slice.top) return;
        const period = this.#period(slice);
        const now = this.rp2040.clock.nanos;
        const wraps = (at) => Math.floor((at - slice.start) / period);
        if (!(slice.csr & CSR_EN) || wraps(now) > wraps(slice.writtenAt)) {
            slice.latched = { cc: slice.cc, top: slice.top };
        }
    }

    /** Fraction of the period that the pin is high. */
    duty(pin) {
        const slice = this.slices[(pin >> 1) & 7];
        this.#latch(slice);
        if (!(slice.csr & CSR_EN)) return 0;
        const level = pin & 1 ? slice.latched.cc >>> 16 : slice.latched.cc & 0xffff;
        const duty = Math.min(level / (slice.latched.top + 1), 1);
        return slice.csr & (pin & 1 ? CSR_B_INV : CSR_A_INV) ? 1 - duty : duty;
    }

    /** Level of a pin now. */
    level(pin) {
        const slice = this.slices[(pin >> 1) & 7];
        const duty = this.duty(pin);
        if (!(slice.csr & CSR_EN)) return 0;
        const period = this.#period(slice);
        const inverted = slice.csr & (pin & 1 ? CSR_B_INV : CSR_A_INV);
        const phase = ((this.rp2040.clock.nanos - slice.start) % period) / period;
        return phase < (inverted ? 1 - duty : duty) === !inverted ? 1 : 0;
    }

    frequency(pin) {
        return 1e9 / this.#period(this.slices[(pin >> 1) & 7]);
    }

    readUint32(offset) {
        if (offset === EN) {
            return this.slices.reduce((mask, slice, i) => mask | ((slice.csr & CSR_EN) << i), 0);
        }
        if (offset >= UNUSED) return 0;
        const slice = this.slices[Math.floor(offset / CHANNEL_SIZE)];
        switch (offset % CHANNEL_SIZE) {
            case CSR:
                return slice.csr;
            case DIV:
                return slice.div;
            case CTR:
                return slice.csr & CSR_EN ? this.#counter(slice) : slice.counter;
            case CC:
                return slice.cc;
            default:
                return slice.top;
        }
    }

    writeUint32(offset, value) {
        if (offset === EN) {
            this.slices.forEach((slice, i) => this.#enable(slice, (value >>> i) & 1));
            return;
        }
        if (offset >= UNUSED) {
            if (value) throw new Error('PWM interrupts are not modelled');
            return;
        }
        const slice = this.slices[Math.floor(offset / CHANNEL_SIZE)];
        this.#latch(slice);
        switch (offset % CHANNEL_SIZE) {
            case CSR:
                if (value & ~(CSR_EN | CSR_A_INV | CSR_B_INV)) throw new Error('this PWM mode is not modelled');
                this.#enable(slice, value & CSR_EN);
                slice.csr = value;
                break;
            case DIV:
                slice.div = value & 0xfff;
                break;
            case CTR: // while it stands, it starts from there; see #enable
                slice.counter = value & 0xffff;
                if (slice.csr & CSR_EN) slice.start = this.#startOf(slice);
                break;
            case CC:
                slice.cc = value >>> 0;
                break;
            default:
                slice.top = value & 0xffff;
        }
        slice.writtenAt = this.rp2040.clock.nanos;
    }

    #enable(slice, on) {
        if (on && !(slice.csr & CSR_EN)) {
            slice.latched = { cc: slice.cc, top: slice.top };
            slice.start = this.#startOf(slice);
        } else if (!on && slice.csr & CSR_EN) {
            slice.counter = this.#counter(slice);
        }
        slice.csr = (slice.csr & ~CSR_EN) | on;
    }
}
