import fs from 'node:fs';

import { NO_PROGRAM, SRAM_BASE } from './chip.js';

const SYMTAB = 2;
const [SP, LR, PC] = [13, 14, 15];
const CALL_STACK = 128; // bytes, more than what is called takes

/** Address and size of a symbol of a 32-bit little-endian ELF file. */
export function extent(file, name) {
    const elf = fs.readFileSync(file);
    const sections = elf.readUInt32LE(32);
    const [size, count] = [elf.readUInt16LE(46), elf.readUInt16LE(48)];
    const section = (index) => {
        const at = sections + index * size;
        return { kind: elf.readUInt32LE(at + 4), offset: elf.readUInt32LE(at + 16), length: elf.readUInt32LE(at + 20),
            link: elf.readUInt32LE(at + 24) };
    };
    for (let index = 0; index < count; index++) {
        const table = section(index);
        if (table.kind !== SYMTAB) continue;
        const strings = section(table.link).offset;
        for (let at = table.offset; at < table.offset + table.length; at += 16) {
            const text = strings + elf.readUInt32LE(at);
            if (elf.toString('latin1', text, elf.indexOf(0, text)) === name) {
                return { at: elf.readUInt32LE(at + 4), size: elf.readUInt32LE(at + 8) };
            }
        }
    }
    throw new Error(`${file} has no symbol ${name}`);
}

export function symbol(file, name) {
    return extent(file, name).at;
}

/** A look at the firmware's own state, as a debug probe gives it; nothing in the board can tell. */
export class Probe {
    constructor(elf, layout) {
        this.board = symbol(elf, 'board');
        this.panic = symbol(elf, 'panic') & ~1;
        this.flags = symbol(elf, 'tl_axis_flags');
        this.usbQueue = ['tud_task_ext', 'dcd_event_handler'].map((name) => extent(elf, name)); // who takes, who puts
        const words = fs.readFileSync(layout);
        [this.axes, this.axisSize, this.mode, this.fault, this.current, this.bad, this.port, this.q, this.reference] =
            Array.from({ length: words.length / 4 }, (_, i) => words.readUInt32LE(4 * i));
    }

    axis(chip, index) {
        const base = this.board + this.axes + index * this.axisSize;
        const begun = chip !== null && chip.readUint32(base + this.port) !== 0;
        if (!begun) return { q_q8: 0, q_ref_q8: 0, mode: 0, fault: 0, flags: 0 };
        return { q_q8: chip.readUint32(base + this.q) | 0, q_ref_q8: chip.readUint32(base + this.reference) | 0,
            mode: chip.readUint8(base + this.mode), fault: chip.readUint8(base + this.fault),
            flags: this.#call(chip.core, this.flags, base) & 0xffff };
    }

    /** What a function of the image that changes nothing makes of its argument. The program does not notice: no time passes. */
    #call(core, at, argument) {
        const names = ['N', 'C', 'Z', 'V', 'PM', 'waiting', 'eventRegistered', 'interruptsUpdated', 'cycles', 'halfword', 'extraCycles'];
        const kept = names.map((name) => core[name]);
        const registers = core.registers.slice();
        const top = registers[SP] & ~7;
        const from = top - SRAM_BASE - CALL_STACK;
        const stack = core.rp2040.sram.slice(from, from + CALL_STACK);
        Object.assign(core, { PM: true, interruptsUpdated: false });
        core.registers[SP] = top;
        core.registers[0] = argument;
        core.registers[LR] = NO_PROGRAM | 1;
        core.registers[PC] = at & ~1;
        while (core.registers[PC] !== NO_PROGRAM) core.executeInstruction();
        const [answer] = core.registers;
        core.registers.set(registers);
        core.rp2040.sram.set(stack, from);
        names.forEach((name, i) => { core[name] = kept[i]; });
        return answer;
    }

    /** Bytes that came and were no frame. */
    bytesBad(chip) {
        return chip.readUint32(this.board + this.bad);
    }

    /** The current that the image last measured, mA. */
    currentMa(chip, index) {
        return chip.readUint32(this.board + this.axes + index * this.axisSize + this.current) | 0;
    }
}
