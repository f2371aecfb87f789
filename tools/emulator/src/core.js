import { CortexM0Core } from './rp2040js.js';

// Cortex-M0+ with zero wait states: 15 cycles from the interrupt to the handler's first instruction, about as many back.
const ENTRY_CYCLES = 15;
const RETURN_CYCLES = 15;

const SEV = 0xbf40;
const WFI = 0xbf30;
const PUSH_LR = 0xb5;
const POP_PC = 0xbd;
const SP = 13;

/**
 * rp2040js's core, mended:
 * - SEV sets the event register;
 * - WFI wakes for a pending interrupt that PRIMASK holds back (and does not enter it), and does not sleep on one;
 * - entering and leaving an exception costs cycles;
 * - PUSH with lr and POP with pc cost the cycle that rp2040js forgets.
 */
export class Core extends CortexM0Core {
    constructor(rp2040) {
        super(rp2040);
        this.halfword = 0;    // the last one read: the instruction, unless it loaded a halfword itself
        this.sleeps = 0;      // times that the program had nothing to do
        this.extraCycles = 0; // of the instruction at hand: exceptions, and stalls (see stall)
    }

    readUint16(address) {
        return (this.halfword = this.rp2040.readUint16(address));
    }

    /** Makes the instruction at hand take this much longer. */
    stall(cycles) {
        this.extraCycles += cycles;
    }

    exceptionEntry(exception) {
        super.exceptionEntry(exception);
        this.extraCycles += ENTRY_CYCLES;
    }

    exceptionReturn(value) {
        super.exceptionReturn(value);
        this.extraCycles += RETURN_CYCLES;
    }

    /** Whether WFI ends: an enabled interrupt is pending above the running priority, whatever PRIMASK says. */
    get wakes() {
        const running = this.exceptionPriority(this.IPSR);
        const pending = this.pendingInterrupts & this.enabledInterrupts;
        for (let priority = 0; priority < running && priority < 4; priority++) {
            if (pending & this.interruptPriorities[priority]) {
                return true;
            }
        }
        return this.pendingNMI || this.pendingPendSV || this.pendingSystick || this.pendingSVCall;
    }

    setInterrupt(irq, value) {
        const bit = 1 << irq;
        if (!value) {
            this.pendingInterrupts &= ~bit;
        } else if (!(this.pendingInterrupts & bit)) {
            this.pendingInterrupts |= bit;
            this.interruptsUpdated = true;
            if (this.waiting && this.wakes) {
                this.waiting = false;
            }
        }
    }

    executeInstruction() {
        while (this.interruptsUpdated && this.checkForInterrupts());
        const sp = this.registers[SP];
        let cycles = super.executeInstruction();
        if (this.registers[SP] !== sp) {
            const operation = this.halfword >>> 8;
            if (operation === PUSH_LR || operation === POP_PC) {
                cycles += 1;
                this.cycles += 1;
            }
        } else if (this.halfword === SEV) {
            this.eventRegistered = true;
        } else if (this.halfword === WFI && this.waiting) {
            this.sleeps += 1;
            if (this.wakes) this.waiting = false;
        }
        if (this.extraCycles !== 0) {
            cycles += this.extraCycles;
            this.cycles += this.extraCycles;
            this.extraCycles = 0;
        }
        return cycles;
    }
}
