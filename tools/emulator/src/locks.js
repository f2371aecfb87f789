const LINE_BYTES = 8;
// A line of the flash cache that has to be filled: 28 cycles of the QSPI clock (24 bits of address and 8 of mode on four
// wires, 4 to wait, 64 bits of data), two of the core's each, and the chip select.
const FILL_CYCLES = 60;
const FLASH = 0x10;

/**
 * How long the image keeps interrupts off, and so the control step out: the longest time since it was last asked for, us, and
 * that of TinyUSB where it puts into its queue or takes from it. Flash is not read in no time meanwhile, but as by a cache that holds
 * nothing of what is needed: the worst that it can.
 */
export class Locks {
    constructor(chip, usbQueue) {
        const { core } = chip;
        const execute = core.executeInstruction.bind(core);
        const lines = new Set();
        let since = 0;
        let from = 0;
        let written = false;
        this.chip = chip;
        this.#forget();
        core.executeInstruction = () => {
            const off = core.PM;
            const cycles = execute();
            if (core.PM && !off) {
                since = core.cycles;
                from = core.LR & ~1;
                written = false;
                lines.clear();
            } else if (core.PM) {
                written ||= !chip.xipOn; // flash is erased or programmed: every motor is off
            } else if (off && !written) {
                const us = (core.cycles - since) * chip.cycleNanos / 1000;
                const kind = usbQueue.some(({ at, size }) => from >= at && from < at + size) ? 'usb' : 'own';
                if (us > this.worst[kind].us) this.worst[kind] = { us, from };
            }
            return cycles;
        };
        for (const name of ['readUint8', 'readUint16', 'readUint32']) {
            const read = chip[name].bind(chip);
            chip[name] = (address) => {
                if (core.PM && address >>> 24 === FLASH) {
                    const line = Math.floor(address / LINE_BYTES);
                    if (!lines.has(line)) {
                        lines.add(line);
                        core.stall(FILL_CYCLES);
                    }
                }
                return read(address);
            };
        }
    }

    #forget() {
        this.worst = { own: { us: 0, from: 0 }, usb: { us: 0, from: 0 } };
    }

    take() {
        const { own, usb } = this.worst;
        this.#forget();
        return { us: own.us, from: `0x${own.from.toString(16)}`, usb_us: usb.us };
    }
}
