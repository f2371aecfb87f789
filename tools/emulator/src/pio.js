import { RPPIO, StateMachine } from './rp2040js.js';

const SHIFTCTRL_FJOIN_RX = 1 << 31;
const IRQ0_INTE = 0x12c;
const IRQ1_INTE = 0x138;
const CHECK_PERIODIC_FROM = 64; // cycles: below, stepping is cheaper than looking for a period

/**
 * A state machine that runs up to a time instead of from setTimeout: in lockstep with the core, at its clock divider.
 * While its inputs stand still a polling loop soon repeats itself exactly; whole rounds of it are then skipped.
 */
class Machine extends StateMachine {
    constructor(rp2040, pio, index) {
        super(rp2040, pio, index);
        this.cycle = 0;  // cycle of the system clock, 1/256 units, up to which it has run
        this.inputs = 0; // the pins, as they were since then
    }

    get inPins() {
        const { inputs, inBase } = this;
        return (inBase ? (inputs << (32 - inBase)) | (inputs >>> inBase) : inputs) >>> 0;
    }

    get period() {
        return (this.clockDivInt || 65536) * 256 + this.clockDivFrac;
    }

    /** One instruction with its delay; returns its cycles of this machine. */
    advance() {
        const before = this.cycles;
        this.step();
        return this.waiting ? 1 : this.cycles - before;
    }

    get key() {
        return `${this.pc},${this.x},${this.y},${this.inputShiftReg},${this.inputShiftCount},` +
            `${this.outputShiftReg},${this.outputShiftCount},${this.waiting},${this.rxFIFO.itemCount},${this.txFIFO.itemCount}`;
    }

    runTo(cycle) {
        const { period } = this;
        if (!this.enabled) {
            this.cycle = cycle;
            return;
        }
        let key = null;
        let keyCycle = 0;
        let last = this.pc;
        while (this.cycle + period <= cycle) {
            const back = this.pc < last; // once a round, whatever loop it is
            last = this.pc;
            if (back && cycle - this.cycle > CHECK_PERIODIC_FROM * period) {
                const now = this.key;
                if (now === key) {
                    const round = this.cycle - keyCycle;
                    this.cycle += Math.floor((cycle - this.cycle) / round) * round;
                    key = null;
                    continue;
                }
                key = now;
                keyCycle = this.cycle;
            }
            this.cycle += this.advance() * period;
        }
    }

    writeUint32(offset, value) {
        const joined = this.shiftCtrl & SHIFTCTRL_FJOIN_RX;
        super.writeUint32(offset, value);
        if ((this.shiftCtrl & SHIFTCTRL_FJOIN_RX) !== joined) { // changing the join empties both FIFOs
            while (!this.rxFIFO.empty) this.rxFIFO.pull();
            while (!this.txFIFO.empty) this.txFIFO.pull();
        }
    }

    clkDivRestart() {} // the divider's phase is that of the clock
}

/**
 * A PIO block in lockstep. It is brought up to date whenever somebody looks: a register is touched or an input pin moves.
 * Its outputs therefore show late; an image that lets it interrupt the core is refused.
 */
export class Pio extends RPPIO {
    constructor(rp2040, name, firstIrq, index) {
        super(rp2040, name, firstIrq, index);
        this.machines = [0, 1, 2, 3].map((i) => new Machine(rp2040, this, i));
    }

    run() {} // not from a timer

    sync() {
        const cycle = Math.floor(this.rp2040.clock.nanos * this.rp2040.clkSys * 256e-9);
        for (const machine of this.machines) {
            machine.runTo(cycle);
        }
        this.checkChangedPins();
    }

    /** Pins as they are from now on; call sync() before the change. */
    setInputs(pins) {
        for (const machine of this.machines) {
            machine.inputs = pins;
        }
    }

    readUint32(offset) {
        this.sync();
        return super.readUint32(offset);
    }

    writeUint32(offset, value) {
        this.sync();
        if ((offset === IRQ0_INTE || offset === IRQ1_INTE) && value) {
            throw new Error('interrupts from PIO are not modelled');
        }
        super.writeUint32(offset, value);
    }
}
