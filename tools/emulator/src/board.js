import fs from 'node:fs';

import { Chip, NO_PROGRAM } from './chip.js';
import { Flash } from './flash.js';
import { Locks } from './locks.js';
import { Plant, STEP_US } from './plant.js';
import { Probe } from './probe.js';
import { SimulationClock } from './rp2040js.js';
import { UsbHost } from './usbhost.js';

const EXCEPTIONS = { nmi: 2, hardfault: 3 };
const CRASH_MOST_US = 1000;

export const TABLE_REGION = 10 * Flash.sectorSize; // at the end of flash: TL_PORT_FLASH_REGION
const ENUMERATION_US = 500e3;                      // a board that is not on the bus by then never will be
const BRANCH_TO_SELF = 0xe7fe;

/**
 * The emulated board: chip, flash, motors and USB host in the time of one world, which starts with the board.
 * Everything is driven by run(); nothing happens between two calls.
 */
export class Board {
    /** image, bootrom: bytes; flashFile: keeps the tables between runs, null: nothing does; revision: see Chip. */
    constructor({ image, bootrom, motor, probe, flashFile = null, id, revision }) {
        this.probe = probe;
        this.revision = revision;
        this.flash = new Flash(2 << 20, id);
        this.flash.bytes.set(image);
        this.bootrom = new Uint32Array(4096);
        new Uint8Array(this.bootrom.buffer).set(bootrom);
        this.flashFile = flashFile;
        this.plant = new Plant(motor);
        this.usb = new UsbHost();
        this.starts = 0;
        this.powered = false;
        this.bootloader = false;
        this.hung = false;
        this.bootUs = 0;
        this.onReset = () => {};
        if (flashFile !== null && fs.existsSync(flashFile)) {
            this.flash.bytes.set(fs.readFileSync(flashFile).subarray(0, TABLE_REGION), this.tableOffset);
        }
        this.flash.onChange = () => this.#save();
        this.flash.onCut = () => { this.chip.state = 'cut'; };
        this.#save();
        this.start();
    }

    get tableOffset() {
        return this.flash.bytes.length - TABLE_REGION;
    }

    get tables() {
        return this.flash.bytes.subarray(this.tableOffset);
    }

    #save() {
        if (this.flashFile !== null) fs.writeFileSync(this.flashFile, this.tables);
    }

    /** Time of the world, us. While the chip runs it is ahead of the plant's by less than a step. */
    get nowUs() {
        return this.chip === null ? this.plant.timeUs : this.bootUs + this.clock.nanos / 1000;
    }

    /** Power on or, with what a watchdog reset keeps, a restart. Motors and time go on where they are. */
    start(kept = null) {
        this.bootUs = this.plant.timeUs;
        this.clock = new SimulationClock();
        this.chip = new Chip({ clock: this.clock, flash: this.flash, bootrom: this.bootrom, kept, revision: this.revision });
        this.powered = true;
        this.bootloader = false;
        this.hung = false;
        this.starts += 1;
        this.plant.attach(this.chip);
        this.usb.attach(this.chip);
    }

    #stop() {
        this.flash.powerCut();
        this.plant.detach();
        this.usb.detach();
        this.chip = null;
        this.onReset();
    }

    /** The power goes at the count-th flash operation from now; 0: it stays. */
    cut(count) {
        this.flash.cutAt = count > 0 ? this.flash.operations + count : 0;
    }

    /** Runs the world up to a time, us. */
    run(untilUs) {
        while (this.chip !== null && this.nowUs < untilUs) {
            this.chip.run((untilUs - this.bootUs) * 1000);
            const { state } = this.chip;
            if (state === 'running') break;
            const { kept } = this.chip;
            this.#stop();
            if (state === 'reset') this.start(kept);
            else if (state === 'bootsel') this.bootloader = true;
            else this.powered = false;
        }
        while (this.chip === null && this.plant.timeUs + STEP_US <= untilUs) this.plant.step();
    }

    /** What the firmware makes of an axis, as the desktop board's `state` has it; zeroes without power. */
    axis(index) {
        return this.probe.axis(this.chip, index);
    }

    /** Runs until something is so, at most some time; whether it came to be. */
    runWhile(going, mostUs) {
        const end = this.nowUs + mostUs;
        while (going() && this.nowUs < end) this.run(this.nowUs + 20);
        return !going();
    }

    waitForUsb() {
        return this.runWhile(() => !this.usb.ready && this.chip !== null, ENUMERATION_US) && this.usb.ready;
    }

    /** The longest time that interrupts were off since the last call, or since the first. */
    locks() {
        if (this.locked?.chip !== this.chip) this.locked = new Locks(this.chip, this.probe.usbQueue);
        return this.locked.take();
    }

    reset() {
        if (this.chip !== null) this.#stop();
        this.start();
    }

    /** The main loop stands still from the next time it is interrupted by nothing; interrupts go on. */
    hang() {
        this.hung = true;
        this.runWhile(() => this.chip.core.IPSR !== 0 || this.chip.core.PM, 10e3);
        const { core } = this.chip;
        this.chip.writeUint16(NO_PROGRAM, BRANCH_TO_SELF);
        core.PC = NO_PROGRAM;
        core.waiting = false;
    }

    /** A debugger holds the core, and nothing else, until the next reset. */
    halt() {
        this.chip.lockedUp = true;
        this.chip.watchdog.halted();
    }

    /**
     * The core takes a 'hardfault' or an 'nmi', or runs into 'panic', wherever it is. Without a debugger it locks up at
     * the breakpoint that comes of it; until then: how long it took, us, and what every bridge pin was before and is then.
     */
    crash(kind) {
        const { chip } = this;
        const { core } = chip;
        const pins = () => [4, 5, 6, 7, 8, 9, 10, 11].map((pin) => chip.output(pin));
        const before = pins();
        const began = this.nowUs;
        chip.onBreakpoint = () => { chip.lockedUp = true; };
        core.waiting = false;
        if (kind === 'panic') core.PC = this.probe.panic;
        else core.exceptionEntry(EXCEPTIONS[kind]);
        while (!chip.lockedUp && this.nowUs < began + CRASH_MOST_US) this.run(this.nowUs + 0.1);
        return { us: this.nowUs - began, before, after: pins(), locked_up: chip.lockedUp };
    }
}

/** A board with the image that './run firmware' built, or with the one in another build folder. */
export function loadBoard(root, options = {}) {
    const usual = `${root}/build/rp2040`;
    const build = options.build ?? usual;
    const file = (name) => {
        if (!fs.existsSync(name)) throw new Error(`${name} is missing: run './run firmware'`);
        return fs.readFileSync(name);
    };
    return new Board({ ...options, probe: new Probe(`${build}/tautline.elf`, `${usual}/emulator/layout.bin`),
        image: file(`${build}/tautline.bin`), bootrom: file(`${usual}/emulator/bootrom.bin`) });
}
