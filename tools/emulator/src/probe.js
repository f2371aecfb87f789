import fs from 'node:fs';

const SYMTAB = 2;

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
        this.usbQueue = ['tud_task_ext', 'dcd_event_handler'].map((name) => extent(elf, name)); // who takes, who puts
        const words = fs.readFileSync(layout);
        [this.axes, this.axisSize, this.mode, this.fault, this.current, this.bad] = [0, 4, 8, 12, 16, 20].map((at) => words.readUInt32LE(at));
    }

    axis(chip, index) {
        const base = this.board + this.axes + index * this.axisSize;
        return { mode: chip.readUint8(base + this.mode), fault: chip.readUint8(base + this.fault) };
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
