// Every mend twice: rp2040js as it is still has the defect, and ours has not. When the first half fails after an update of
// rp2040js, the mend can go.
import assert from 'node:assert/strict';
import { test } from 'node:test';

import { Chip } from '../src/chip.js';
import { Flash } from '../src/flash.js';
import { RP2040, SimulationClock } from '../src/rp2040js.js';
import { setupPacket } from '../src/usbhost.js';

const RAM = 0x20000000;
const STACK = 0x20001000;
const HANDLER = 0x20000800; // of every interrupt
const IRQ = 5;

const quiet = { debug() {}, info() {}, warn() {}, error() {} };

/** Either chip with a vector table at the start of RAM and a program of halfwords behind it, ready to run it. */
function chipWith(make, program) {
    const chip = make();
    chip.logger = quiet;
    for (let vector = 0; vector < 48; vector++) chip.writeUint32(RAM + 4 * vector, HANDLER | 1);
    chip.writeUint32(RAM, STACK);
    program.forEach((halfword, i) => chip.writeUint16(RAM + 0x100 + 2 * i, halfword));
    chip.writeUint16(HANDLER, 0x4770); // bx lr
    chip.core.VTOR = RAM;
    chip.core.SP = STACK;
    chip.core.PC = RAM + 0x100;
    return chip;
}
const plain = (program = []) => chipWith(() => new RP2040(new SimulationClock()), program);
const mended = (program = []) =>
    chipWith(() => new Chip({ clock: new SimulationClock(), flash: new Flash(), bootrom: new Uint32Array(4096) }), program);

function step(chip, count) {
    let cycles = 0;
    for (let i = 0; i < count && !chip.core.waiting; i++) cycles += chip.core.executeInstruction();
    return cycles;
}

/** `probe(chip maker)` is what is observed. */
function mend(name, probe, defect, right) {
    test(name, () => {
        assert.deepEqual(probe(plain), defect, `rp2040js has changed: if it gives ${JSON.stringify(right)}, this mend can go`);
        assert.deepEqual(probe(mended), right);
    });
}

const NOP = 0x46c0;
const SEV = 0xbf40;
const WFE = 0xbf20;
const WFI = 0xbf30;
const CPSID = 0xb672;
const CPSIE = 0xb662;

mend('SEV sets the event that WFE takes',
    (make) => {
        const chip = make([SEV, WFE, NOP]);
        step(chip, 2);
        return chip.core.waiting;
    }, true, false);

mend('WFI does not sleep on an interrupt that is pending and masked',
    (make) => {
        const chip = make([CPSID, NOP, WFI, NOP]);
        chip.core.enabledInterrupts = 1 << IRQ;
        step(chip, 2);
        chip.setInterrupt(IRQ, true);
        step(chip, 1);
        return chip.core.waiting;
    }, true, false);

mend('WFI under PRIMASK wakes without entering the handler',
    (make) => {
        const chip = make([CPSID, WFI, NOP, NOP]);
        chip.core.enabledInterrupts = 1 << IRQ;
        step(chip, 2);
        chip.setInterrupt(IRQ, true);
        return { waiting: chip.core.waiting, inHandler: chip.core.IPSR !== 0 };
    }, { waiting: false, inHandler: true }, { waiting: false, inHandler: false });

mend('an exception costs 15 cycles in and 15 out',
    (make) => {
        const chip = make([CPSIE, NOP, NOP]);
        chip.core.enabledInterrupts = 1 << IRQ;
        step(chip, 2);
        chip.setInterrupt(IRQ, true);
        return step(chip, 1); // enters, and returns: the handler is one BX
    }, 2, 32);

mend('PUSH with lr costs 1 + N cycles, POP with pc 3 + N',
    (make) => {
        const chip = make([0xb530 /* push {r4, r5, lr} */, 0xbd30 /* pop {r4, r5, pc} */]);
        chip.core.LR = (RAM + 0x100) | 1;
        return [step(chip, 1), step(chip, 1)];
    }, [3, 5], [4, 6]);

mend('the timer shows the alarm\'s time when it fires',
    (make) => {
        const chip = make();
        chip.clock.tick(10700);
        const fired = [];
        chip.setInterrupt = (irq, on) => on && irq === 0 && fired.push(chip.readUint32(0x40054028));
        chip.writeUint32(0x40054038, 1);  // INTE
        chip.writeUint32(0x40054010, 20); // ALARM0
        chip.clock.tick(100000);
        return fired;
    }, [19], [20]);

mend('the watchdog bites once',
    (make) => {
        const chip = make();
        let bites = 0;
        const watchdog = chip.peripherals[0x40058];
        watchdog['onBite' in watchdog ? 'onBite' : 'onWatchdogTrigger'] = () => {
            bites += 1;
            if (bites === 3) watchdog.timer.enable = false; // or it would bite for ever, at the same instant
        };
        chip.writeUint32(0x40058004, 2000);
        chip.writeUint32(0x40058000, 1 << 30);
        chip.clock.tick(2e6);
        return bites;
    }, 3, 1);

test('reset() of rp2040js wipes the flash; ours is another chip with the same flash', () => {
    const chip = plain();
    chip.flash[0] = 0x12;
    chip.reset();
    assert.equal(chip.flash[0], 0xff, 'rp2040js has changed: its reset() may do');
});

const PIO0 = 0x50200000;
const SM0 = { clkdiv: 0xc8, execctrl: 0xcc, shiftctrl: 0xd0 };

/** A state machine that counts its rounds in Y for 100 cycles of the core. */
function rounds(chip, divider) {
    chip.writeUint32(PIO0 + 0x48, 0x0080);          // jmp y-- 0
    chip.writeUint32(PIO0 + SM0.execctrl, 0 << 12); // wrap at 0
    chip.writeUint32(PIO0 + SM0.clkdiv, (divider << 16) >>> 0);
    chip.writeUint32(PIO0, 1);
    chip.clock.tick(800);
    chip.readUint32(PIO0 + 0x4);
    return -chip.pio[0].machines[0].y | 0;
}

test('PIO runs in lockstep with the core, at its clock divider', () => {
    const chip = plain();
    assert.notEqual(rounds(chip, 1), 100, 'rp2040js has changed: PIO may run in lockstep now');
    chip.pio[0].stop();
    assert.equal(rounds(mended(), 1), 100);
    assert.equal(rounds(mended(), 4), 25);
});

mend('changing the FIFO join empties the FIFOs',
    (make) => {
        const chip = make();
        chip.pio[0].machines[0].rxFIFO.push(7);
        chip.writeUint32(PIO0 + SM0.shiftctrl, (1 << 31) >>> 0);
        return chip.pio[0].machines[0].rxFIFO.itemCount;
    }, 1, 0);

const USB = 0x50110000;
const DPRAM = 0x50100000;

function usbChip(make) {
    const chip = make();
    chip.writeUint32(USB + 0x40, 1);       // controller on
    chip.writeUint32(USB + 0x4c, 1 << 16); // pull-up
    chip.writeUint32(DPRAM + 0x08, ((1 << 31) | (1 << 29) | (2 << 26) | 0x180) >>> 0); // EP1 IN: bulk
    return chip;
}

test('USB moves a packet when a token asks for it, not when the firmware offers it', () => {
    const offer = (chip) => chip.writeUint32(DPRAM + 0x88, (1 << 15) | (1 << 13) | (1 << 10) | 3);
    const before = usbChip(plain);
    offer(before);
    assert.notEqual(before.readUint32(USB + 0x58), 0, 'rp2040js has changed: does it wait for tokens now?');

    const chip = usbChip(mended);
    assert.equal(chip.usbCtrl.in(0, 1), 'nak');
    chip.writeUint32(DPRAM + 0x180, 0x00332211);
    offer(chip);
    assert.equal(chip.readUint32(USB + 0x58), 0);
    assert.deepEqual(chip.usbCtrl.in(0, 1), { data: Uint8Array.of(0x11, 0x22, 0x33), toggle: 1 });
    assert.equal(chip.readUint32(USB + 0x58), 1 << 2);
    assert.equal(chip.usbCtrl.in(0, 1), 'nak');
    assert.equal(chip.usbCtrl.in(9, 1), 'timeout'); // another address
});

test('USB: a double-buffered IN keeps its order and tells of both at once', () => {
    const chip = usbChip(mended);
    chip.writeUint32(DPRAM + 0x08, ((1 << 31) | (1 << 30) | (1 << 28) | (2 << 26) | 0x180) >>> 0);
    chip.writeUint32(DPRAM + 0x180, 0xaa);
    chip.writeUint32(DPRAM + 0x1c0, 0xbb);
    const half = (1 << 15) | (1 << 10) | 1;
    chip.writeUint32(DPRAM + 0x88, (((half | (1 << 13)) << 16) | half | (1 << 12)) >>> 0);
    assert.deepEqual(chip.usbCtrl.in(0, 1), { data: Uint8Array.of(0xaa), toggle: 0 });
    assert.equal(chip.readUint32(USB + 0x58), 0);
    assert.deepEqual(chip.usbCtrl.in(0, 1), { data: Uint8Array.of(0xbb), toggle: 1 });
    assert.equal(chip.readUint32(USB + 0x58), 1 << 2);
});

test('USB: STALL, a wrong toggle, and a SETUP that clears the stall of endpoint 0', () => {
    const chip = usbChip(mended);
    chip.writeUint32(USB + 0x68, 1);             // EP0 IN armed
    chip.writeUint32(DPRAM + 0x80, 1 << 11);
    assert.equal(chip.usbCtrl.in(0, 0), 'stall');
    assert.equal(chip.usbCtrl.setup(0, setupPacket(0x80, 6, 0x100, 0, 18)), 'ack');
    assert.equal(chip.usbCtrl.in(0, 0), 'nak');
    assert.ok(chip.readUint32(USB + 0x50) & (1 << 17)); // SETUP_REC

    chip.writeUint32(DPRAM + 0x0c, ((1 << 31) | (1 << 29) | (2 << 26) | 0x200) >>> 0); // EP1 OUT
    chip.writeUint32(DPRAM + 0x8c, (1 << 10) | 64);
    assert.equal(chip.usbCtrl.out(0, 1, 1, Uint8Array.of(5)), 'ack'); // taken for a repetition
    assert.equal(chip.usbCtrl.toggleErrors, 1);
    assert.equal(chip.readUint32(USB + 0x58), 0);
    assert.equal(chip.usbCtrl.out(0, 1, 0, Uint8Array.of(6)), 'ack');
    assert.equal(chip.readUint8(DPRAM + 0x200), 6);
    assert.equal(chip.usbCtrl.out(0, 1, 1, Uint8Array.of(7)), 'nak');
});

mend('start of frame',
    (make) => {
        const chip = usbChip(make);
        chip.writeUint32(USB + 0x90, 1 << 17);
        chip.usbCtrl.startOfFrame?.();
        const seen = () => (chip.readUint32(USB + 0x98) >>> 17) & 1;
        return [seen(), chip.readUint32(USB + 0x48), seen()]; // reading the number acknowledges it
    }, [0, 0, 0], [1, 1, 0]);

mend('the flash chip answers with its id and with quad mode on',
    (make) => {
        const chip = make();
        const transfer = (...bytes) => {
            chip.writeUint32(0x4001800c, 2 << 8); // chip select low
            const answer = bytes.map((byte) => {
                chip.writeUint32(0x18000060, byte);
                return chip.readUint32(0x18000060);
            });
            chip.writeUint32(0x4001800c, 3 << 8);
            return answer;
        };
        return [transfer(0x4b, 0, 0, 0, 0, 0, 0).slice(5), transfer(0x35, 0).slice(1)];
    }, [[0, 0], [0]], [[0x7a, 0x75], [2]]);
