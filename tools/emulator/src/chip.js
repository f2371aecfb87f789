import { RP2040 } from './rp2040js.js';
import { Core } from './core.js';
import { Pio } from './pio.js';
import { UsbController } from './usb.js';
import { IoQspi, Pads, Pwm, Registers, Ssi, Timer, Watchdog } from './peripherals.js';

export const SRAM_BASE = 0x20000000;
export const NO_PROGRAM = 0x20040000; // no program is there, and no stack is as deep
const BOOT2_SIZE = 256;
const POLL_CYCLES = 125; // of the ROM waiting for the flash chip: a microsecond

const OUTOVER_LOW = 2; // of a pin's control register: its output, whatever its function does
const OUTOVER_HIGH = 3;
const FUNCTION_PWM = 4;
const FUNCTION_SIO = 5;
const PIO0_IRQ0 = 7;
const PIO1_IRQ0 = 9;

const EMPTY = new Uint8Array(0);
const EMPTY_VIEW = new DataView(EMPTY.buffer);

/** Something that no correct image does: the run ends with it. */
export class Fault extends Error {}

const hex = (value) => `0x${(value >>> 0).toString(16).padStart(8, '0')}`;

/** CRC-32 as the boot ROM checks the second stage: not reflected, starts with ones, not inverted at the end. */
export function boot2Crc(bytes) {
    let crc = 0xffffffff;
    for (const byte of bytes) {
        crc ^= byte << 24;
        for (let bit = 0; bit < 8; bit++) crc = crc & 0x80000000 ? (crc << 1) ^ 0x04c11db7 : crc << 1;
    }
    return crc >>> 0;
}

/** Every complaint of rp2040js is the image's fault or a gap in the emulator; both must be seen. */
class StrictLogger {
    debug() {}
    info() {}
    warn(component, message) {
        throw new Fault(`${component}: ${message}`);
    }
    error(component, message) {
        throw new Fault(`${component}: ${message}`);
    }
}

/**
 * An RP2040 from power-on to the next reset, which is another Chip with the same flash. `kept` is what a watchdog reset keeps.
 * `revision`: a B1 has erratum E5, and is on a busy hub (see UsbController).
 */
export class Chip extends RP2040 {
    constructor({ clock, flash, bootrom, kept = null, revision = 'B2' }) {
        super(clock);
        this.hasE5 = revision === 'B1';
        this.logger = new StrictLogger();
        this.flashChip = flash;
        this.core = new Core(this);
        this.usbCtrl = new UsbController(this, 'USB');
        this.pio = [new Pio(this, 'PIO0', PIO0_IRQ0, 0), new Pio(this, 'PIO1', PIO1_IRQ0, 1)];
        this.pwm = new Pwm(this, 'PWM');
        this.ssi = new Ssi(this);
        this.watchdog = new Watchdog(this, 'WATCHDOG');
        Object.assign(this.peripherals, {
            0x14000: new Registers(this, 'XIP_CTRL', { 0x8: 3 }), // cache: enabled, flushed
            0x18000: this.ssi,
            0x40000: new Registers(this, 'SYSINFO', { 0x0: this.hasE5 ? 0x10002927 : 0x20002927, 0x4: 2 }), // an ASIC
            0x40018: new IoQspi(this),
            0x4001c: new Pads(this, 'PADS_BANK0', 'bank0'),
            0x40050: this.pwm,
            0x40054: new Timer(this, 'TIMER'),
            0x40058: this.watchdog,
            0x40060: new Registers(this, 'ROSC', { 0x18: 0x80000000 }),
            0x40064: new Registers(this, 'VREG', { 0x0: 0x10b1, 0x8: 0 }),
            0x50110: this.usbCtrl,
            0x50200: this.pio[0],
            0x50300: this.pio[1],
        });
        this.chipSelectForced = false;
        this.inputs = 0;
        this.state = 'running';  // 'bootsel': the ROM's USB boot; 'reset': the watchdog has bitten
        this.cycleNanos = 1e9 / this.clkSys;
        this.addClockListener((frequency) => { this.cycleNanos = 1e9 / frequency; });
        this.onBreak = (code) => this.#romCall(code);
        this.onBreakpoint = (code) => { throw new Fault(`breakpoint ${code} at ${hex(this.core.PC - 2)}`); };
        this.watchdog.onBite = () => { this.state = 'reset'; };
        if (kept) {
            this.watchdog.scratchData.set(kept.scratch);
            this.watchdog.reason = kept.reason;
        }
        this.bootrom.set(bootrom);
        this.flash = EMPTY;
        this.flashView = EMPTY_VIEW;
        this.xipOn = false;
        this.lockedUp = false; // a breakpoint without a debugger: the core does nothing until a reset
        this.core.reset();
    }

    get kept() {
        return { scratch: this.watchdog.scratchData.slice(), reason: this.watchdog.reason };
    }

    /** Whether the flash is mapped. While it is not, its addresses lead to findPeripheral. */
    set xip(on) {
        this.xipOn = on;
        this.flash = on ? this.flashChip.bytes : EMPTY;
        this.flashView = on ? new DataView(this.flash.buffer) : EMPTY_VIEW;
    }

    findPeripheral(address) {
        const top = address >>> 24;
        if (top === 0x20) return undefined; // RAM, most writes
        if (top >= 0x10 && top < 0x14) {
            throw new Fault(`${this.xipOn ? 'write to flash, or beyond its end' : 'flash fetch while XIP is off'}: ` +
                `${hex(address)}, pc ${hex(this.core.PC)}`);
        }
        return super.findPeripheral(address);
    }

    #romCall(code) {
        const { core, flashChip, clock } = this;
        const [r0, r1, r2] = core.registers;
        switch (code) {
            case 0xe0: { // load the second stage
                const stage = flashChip.bytes.subarray(0, BOOT2_SIZE);
                const crc = new DataView(stage.buffer, stage.byteOffset).getUint32(BOOT2_SIZE - 4, true);
                this.sram.set(stage, r0 - SRAM_BASE);
                core.registers[0] = boot2Crc(stage.subarray(0, BOOT2_SIZE - 4)) === crc ? 1 : 0;
                break;
            }
            case 0xe1: // USB boot
                this.state = 'bootsel';
                break;
            case 0xe2: // connect
            case 0xe7: // flush the cache
                break;
            case 0xe3:
                this.xip = false;
                break;
            case 0xe4:
                this.#needsXipOff('erase');
                flashChip.erase(clock.nanos, r0, r1);
                break;
            case 0xe5: {
                this.#needsXipOff('program');
                const from = r1 - SRAM_BASE;
                if (from < 0 || from + r2 > this.sram.length) throw new Fault(`flash programmed from ${hex(r1)}, not from RAM`);
                flashChip.program(clock.nanos, r0, this.sram.slice(from, from + r2));
                break;
            }
            case 0xe6:
                core.stall(POLL_CYCLES);
                core.registers[0] = flashChip.busy(clock.nanos) ? 1 : 0;
                break;
            case 0xe8:
                this.xip = true;
                break;
            default:
                this.onBreakpoint(code);
        }
    }

    #needsXipOff(what) {
        if (this.xipOn) throw new Fault(`flash ${what} while the flash is mapped`);
    }

    /** A pin driven from outside. */
    drive(pin, high) {
        const bit = 1 << pin;
        if (!(this.inputs & bit) === !high) return;
        this.inputs ^= bit;
        this.changeInputs(() => this.gpio[pin].setInputValue(high));
    }

    /** What changes the pins that the state machines see, from now on. */
    changeInputs(change) {
        for (const pio of this.pio) pio.sync();
        change();
        const seen = this.gpioValues;
        for (const pio of this.pio) pio.setInputs(seen);
    }

    /** Average level of a pin that the chip drives, 0 to 1; an undriven one is pulled low by what it leads to. */
    output(pin) {
        const gpio = this.gpio[pin];
        const forced = (gpio.ctrl >>> 8) & 3;
        if (forced >= OUTOVER_LOW) return forced === OUTOVER_HIGH ? 1 : 0;
        switch (gpio.functionSelect) {
            case FUNCTION_PWM:
                return this.pwm.duty(pin);
            case FUNCTION_SIO:
                return this.sio.gpioOutputEnable & this.sio.gpioValue & (1 << pin) ? 1 : 0;
            default:
                return 0;
        }
    }

    /** Level of a pin now, 0 or 1. */
    level(pin) {
        const { ctrl, functionSelect } = this.gpio[pin];
        return functionSelect === FUNCTION_PWM && ((ctrl >>> 8) & 3) < OUTOVER_LOW ? this.pwm.level(pin) : this.output(pin);
    }

    /** Runs up to a time of its clock, or until its state changes. */
    run(until) {
        const { core, clock } = this;
        while (clock.nanos < until && this.state === 'running') {
            if (core.waiting || this.lockedUp) {
                const next = clock.nextAlarm;
                clock.tick((next && next.nanos < until ? next.nanos : until) - clock.nanos);
            } else {
                clock.tick(core.executeInstruction() * this.cycleNanos);
            }
        }
    }
}
