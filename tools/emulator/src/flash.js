const SECTOR = 4096;
const PAGE = 256;

// W25Q16JV, typical.
const ERASE_NANOS = 45e6;
const PROGRAM_NANOS = 0.4e6;

/**
 * The flash chip: NOR, so that programming only clears bits, and an operation that is cut short leaves some of them done.
 * An operation is one sector erased or one page programmed; `operations` counts them, `cutAt` names the one at which the power goes.
 */
export class Flash {
    constructor(size = 2 << 20, id = [0x7a, 0x75, 0x74, 0x6c, 0x69, 0x6e, 0x65, 0x01]) {
        this.bytes = new Uint8Array(size).fill(0xff);
        this.id = id;
        this.operations = 0;
        this.cutAt = 0;      // 0: never
        this.onCut = () => {};
        this.onChange = () => {};
        this.queue = [];     // what is under way: {nanos, apply}
        this.until = 0;
    }

    static get sectorSize() {
        return SECTOR;
    }

    #start(now, operation) {
        if (this.queue.length === 0) {
            this.until = now + operation.nanos;
        }
        this.queue.push(operation);
    }

    erase(now, offset, count) {
        for (let at = offset; at < offset + count; at += SECTOR) {
            this.#start(now, { nanos: ERASE_NANOS, from: at, to: at + SECTOR, data: null });
        }
    }

    program(now, offset, data) {
        for (let at = 0; at < data.length; at += PAGE) {
            const page = data.slice(at, at + PAGE);
            this.#start(now, { nanos: PROGRAM_NANOS, from: offset + at, to: offset + at + page.length, data: page });
        }
    }

    /** Finishes what has had its time; whether something is still under way. */
    busy(now) {
        while (this.queue.length > 0 && now >= this.until) {
            const operation = this.queue.shift();
            this.operations += 1;
            const cut = this.operations === this.cutAt;
            this.#apply(operation, cut ? 0.5 : 1);
            this.onChange(operation.from, operation.to);
            if (cut) {
                this.queue = [];
                this.cutAt = 0;
                this.onCut();
                return false;
            }
            if (this.queue.length > 0) {
                this.until += this.queue[0].nanos;
            }
        }
        return this.queue.length > 0;
    }

    /** `part` of the operation: a page up to a byte, and there half of its bits; a sector with every second byte half erased. */
    #apply({ from, to, data }, part) {
        const { bytes } = this;
        if (data !== null) {
            const whole = Math.floor(data.length * part);
            for (let i = 0; i < whole; i++) bytes[from + i] &= data[i];
            if (part < 1) bytes[from + whole] &= data[whole] | 0x0f;
        } else {
            for (let i = from; i < to; i++) bytes[i] = part === 1 ? 0xff : bytes[i] | (i & 1 ? 0xff : 0x55);
        }
    }

    /** The power went: what was under way stays half done. */
    powerCut() {
        if (this.queue.length > 0) {
            this.#apply(this.queue[0], 0.5);
            this.onChange(this.queue[0].from, this.queue[0].to);
            this.queue = [];
        }
    }
}
