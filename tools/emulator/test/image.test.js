// The image on the emulated chip, in one process and so the same every time: what no host can see or arrange.
import assert from 'node:assert/strict';
import path from 'node:path';
import { test } from 'node:test';
import { fileURLToPath } from 'node:url';

import { loadBoard } from '../src/board.js';
import { Fault, NO_PROGRAM } from '../src/chip.js';
import { motorConstants } from '../src/plant.js';
import { symbol } from '../src/probe.js';
import { ACK } from '../src/usb.js';
import { setupPacket } from '../src/usbhost.js';

const root = path.resolve(path.dirname(fileURLToPath(import.meta.url)), '../../..');
const motor = motorConstants(path.join(root, 'firmware/port/simulated/motor.c'));
const elf = path.join(root, 'build/rp2040/tautline.elf');
const WATCHDOG_FAULT = 6; // TL_WIRE_FAULTS
const EDGES_FAULT = 9;
const AT_REST = 1 << 1; // TL_WIRE_FLAGS
const SM_Y = (chip, axis) => chip.pio[0].machines[axis].y | 0;

function booted() {
    const board = loadBoard(root, { motor });
    assert.ok(board.waitForUsb(), 'the image comes up on USB');
    return board;
}

test('it enumerates: descriptors, a configuration, its serial number, a request that it stalls', () => {
    const board = booted();
    const { usb } = board;
    assert.deepEqual([...usb.deviceDescriptor.slice(0, 4)], [18, 1, 0x10, 0x02]);
    assert.equal(usb.configDescriptor[4], 2);
    const control = (setup) => {
        let answer = null;
        usb.submit({ endpoint: 0, out: !(setup[0] & 0x80), setup, data: new Uint8Array(0), length: setup[6] | (setup[7] << 8),
            done: (status, data) => { answer = { status, data }; } });
        board.runWhile(() => answer === null, 50e3);
        return answer;
    };
    assert.equal(control(setupPacket(0, 9, 1, 0, 0)).status, 0);                          // set configuration
    const serial = control(setupPacket(0x80, 6, 0x303, 0x409, 255));
    assert.equal(Buffer.from(serial.data.slice(2)).toString('utf16le'), '7A75746C696E6501'); // the flash chip's id
    assert.equal(control(setupPacket(0x80, 6, 0x3ee, 0x409, 255)).status, -32);           // no such string: STALL
    assert.equal(control(setupPacket(0, 9, 0, 0, 0)).status, 0);                          // and it goes on
    assert.equal(usb.toggleErrors + board.chip.usbCtrl.toggleErrors, 0);
});

test('an endpoint whose halt is cleared beside a packet that completes goes on', () => {
    const clear = symbol(elf, '__wrap_dcd_edpt_clear_stall') & ~1;
    const answers = new Set();
    for (let after = 0; after < 120; after += 10) { // instructions into the clearing
        const board = booted();
        const { usb, chip } = board;
        const submit = (endpoint, setup, length) => {
            const transfer = { status: null };
            usb.submit({ endpoint, out: true, setup, data: new Uint8Array(length), length,
                done: (status) => { transfer.status = status; } });
            return transfer;
        };
        const done = (transfer) => board.runWhile(() => transfer.status === null, 50e3) && transfer.status === 0;
        assert.ok(done(submit(0, setupPacket(0, 9, 1, 0, 0), 0)));
        const { core } = chip;
        const execute = core.executeInstruction.bind(core);
        let left = -1;
        let answer = null;
        core.executeInstruction = () => {
            if (left < 0 && (core.PC & ~1) === clear) left = after;
            else if (left > 0) left -= 1;
            if (left === 0 && answer === null) answer = chip.usbCtrl.out(usb.address, 1, 0, new Uint8Array(5));
            return execute();
        };
        assert.ok(done(submit(0, setupPacket(2, 1, 0, 1, 0), 0)), 'CLEAR_FEATURE(ENDPOINT_HALT)');
        assert.notEqual(answer, null);
        for (let packet = 0; packet < 4; packet++) {
            assert.ok(done(submit(1, null, 64)), `packet ${packet}, ${after} instructions in, answered ${answer}`);
        }
        board.run(board.nowUs + 2000);
        const took = (answer === ACK ? 5 : 0) + 4 * 64;
        assert.equal(board.probe.bytesBad(chip), took, `${after} instructions in, answered ${answer}`);
        answers.add(answer);
        assert.equal(usb.toggleErrors + chip.usbCtrl.toggleErrors, 0);
    }
    assert.ok(answers.has(ACK), 'a packet came in time');
});

test('two runs are the same to the cycle and the byte, also where a probe looks on', () => {
    const state = (looks = 1) => {
        const board = booted();
        for (let look = 1; look <= looks; look++) {
            board.run(60e3 * look / looks);
            for (let axis = 0; axis < 4; axis++) assert.ok(board.axis(axis).flags & AT_REST);
        }
        const { core } = board.chip;
        return { cycles: core.cycles, nanos: board.clock.nanos, registers: [...core.registers],
            memory: board.chip.sram.reduce((sum, byte) => (Math.imul(sum, 31) + byte) | 0, 0) };
    };
    assert.deepEqual(state(), state());
    assert.deepEqual(state(), state(600));
});

test('no edge is lost at 200 000 counts/s, on four encoders, both ways', () => {
    const board = booted();
    const { chip } = board;
    const pins = [0, 2, 12, 14];
    const states = [0b00, 0b10, 0b11, 0b01];
    const start = pins.map((_, axis) => SM_Y(chip, axis));
    const count = [0, 0, 0, 0];
    const way = [1, -1, 1, -1];
    board.plant.alarm.cancel(); // the motors stand still: the pins are ours
    for (let edge = 0; edge < 8000; edge++) {
        board.run(board.nowUs + 5);
        pins.forEach((pin, axis) => {
            if (edge === 5000 + 300 * axis) way[axis] = -way[axis];
            count[axis] += way[axis];
            const state = states[((count[axis] % 4) + 4) % 4];
            chip.drive(pin, (state & 1) !== 0);
            chip.drive(pin + 1, (state & 2) !== 0);
        });
    }
    board.run(board.nowUs + 1);
    chip.pio[0].sync();
    assert.deepEqual(pins.map((_, axis) => SM_Y(chip, axis) - start[axis]), count);
    assert.equal(chip.readUint32(0x50200030) & 0xf, 0, 'no state machine saw both pins change');
    for (const pin of [12, 13]) chip.drive(pin, !chip.gpio[pin].inputValue); // both at once
    board.run(board.nowUs + 3000);
    assert.deepEqual([0, 1, 2, 3].map((axis) => board.axis(axis).fault), [0, 0, EDGES_FAULT, 0], 'a lost edge is told');
});

/** Sets both lines of an encoder; the plant's motors stand still. */
function show(board, axis, state) {
    const pin = [0, 2, 12, 14][axis];
    board.chip.drive(pin, (state & 1) !== 0);
    board.chip.drive(pin + 1, (state & 2) !== 0);
}

test('a glitch beside an edge is no lost edge, and both lines count on right after it', () => {
    const board = booted();
    const { chip } = board;
    board.plant.alarm.cancel();
    const start = SM_Y(chip, 0);
    const turn = [0b00, 0b10, 0b11, 0b01];
    for (let edge = 1; edge <= 200; edge++) {
        show(board, 0, turn[(edge + 1) % 4]); // this edge, and for half a microsecond the other line, too
        board.run(board.nowUs + 0.5);
        show(board, 0, turn[edge % 4]);
        board.run(board.nowUs + 20);
    }
    chip.pio[0].sync();
    assert.equal(SM_Y(chip, 0) - start, 200);
    board.run(board.nowUs + 3000);
    assert.equal(board.axis(0).fault, 0);
});

test('an encoder that rests in any state when the board starts again counts from there', () => {
    const board = booted();
    for (const state of [1, 2, 3]) { // counts from where both lines are low
        board.plant.motors.forEach((motor, axis) => { motor.position += state + axis; });
        board.run(board.nowUs + 100);
        board.reset();
        assert.ok(board.waitForUsb());
        for (const way of [1, 1, -1]) {
            board.plant.motors.forEach((motor) => { motor.position += way; });
            board.run(board.nowUs + 5000);
        }
        assert.deepEqual([0, 1, 2, 3].map((axis) => [board.axis(axis).fault, SM_Y(board.chip, axis)]), Array(4).fill([0, 1]));
    }
});

test('lines that rise slowly after the pull-ups went on are no edges', () => {
    const board = loadBoard(root, { motor });
    const PULL_UP = 1 << 3;
    const pads = 0x4001c004;
    board.plant.alarm.cancel();
    assert.ok(board.runWhile(() => (board.chip.readUint32(pads + 4 * 15) & PULL_UP) === 0, 500e3));
    assert.ok(board.chip.readUint32(pads + 4 * 16) & PULL_UP); // the stop input's: nothing wired is no stop
    board.run(board.nowUs + 300);
    for (const axis of [0, 1, 2, 3]) show(board, axis, 0b11);
    assert.ok(board.waitForUsb());
    board.run(board.nowUs + 5000);
    assert.deepEqual([0, 1, 2, 3].map((axis) => [board.axis(axis).fault, SM_Y(board.chip, axis)]), Array(4).fill([0, 0]));
});


test('an alarm that passes while it is set comes a period later, not 71 minutes', () => {
    const board = booted();
    const timer = board.chip.peripherals[0x40054];
    const write = timer.writeUint32.bind(timer);
    let delays = 0;
    timer.writeUint32 = (offset, value) => {
        if (offset === 0x10 && delays === 0) {
            delays += 1;
            board.clock.tick(250e3); // the core was held up between looking at the time and setting the alarm
        }
        write(offset, value);
    };
    board.run(board.nowUs + 1000);
    assert.equal(delays, 1);
    const before = board.starts;
    board.run(board.nowUs + 400e3); // the watchdog would bite
    assert.equal(board.starts, before);
});

test('the most of four samples counts: a driver that chops is not taken for one without current', () => {
    const board = booted();
    const { chip } = board;
    const sense = chip.adc.onADCRead;
    for (const shown of [0, 1, 2, 3]) { // the one that meets the chopper conducting
        let sample = 0;
        let last = -Infinity;
        const gaps = [];
        chip.adc.onADCRead = (channel) => {
            const now = board.clock.nanos;
            sample = now - last > 20e3 ? 0 : sample + 1; // a tick is 200 us
            if (sample > 0 && sample < 4) gaps.push((now - last) / 1000);
            last = now;
            sense(channel);
            chip.adc.channelValues[3] = sample === shown ? 248 : 3; // 425 mA, 5 mA
        };
        board.run(board.nowUs + 20e3);
        for (let axis = 0; axis < 4; axis++) {
            const current = board.probe.currentMa(chip, axis);
            assert.ok(Math.abs(current - 425) < 3, `${current} mA of axis ${axis} where sample ${shown} shows it`);
        }
        assert.ok(gaps.every((us) => us > 2.5 && us < 3.5), `${Math.min(...gaps)} to ${Math.max(...gaps)} us apart`);
    }
});

test('what has to be in time, or has to work without flash, runs from RAM', () => {
    for (const name of ['start_in_time', 'control_interrupt', 'isr_hardfault', 'isr_nmi', 'board_panic', 'coast_and_wait', 'bridge_coast_all']) {
        const at = symbol(elf, name);
        assert.ok(at >= 0x20000000 && at < 0x20042000, `${name} is at 0x${at.toString(16)}`);
    }
});

/** How long before the end of a PWM period each tick's first sample was taken, us. */
function sampledBeforeTheEnd(board, ticks) {
    const { chip } = board;
    const before = [];
    const sense = chip.adc.onADCRead;
    const period = 50;
    let last = board.clock.nanos; // several samples a step: the first is the one after a pause
    chip.adc.onADCRead = (channel) => {
        const { nanos } = board.clock;
        if (nanos - last > 100e3) before.push(period - ((nanos - chip.pwm.slices[2].start) / 1000) % period);
        last = nanos;
        sense(channel);
    };
    board.run(board.nowUs + 200 * ticks);
    chip.adc.onADCRead = sense;
    assert.ok(before.length >= ticks - 2);
    return before;
}

function assertInPhase(before, when) {
    assert.ok(before.every((us) => us > 0.1 && us < 1.5),
        `${Math.min(...before)} to ${Math.max(...before)} us before the end ${when}`);
}

test('currents are first sampled just before the end of a PWM period', () => {
    assertInPhase(sampledBeforeTheEnd(booted(), 20), 'from the start');
});

test('currents are sampled in the same phase after the control step was held up', () => {
    const board = booted();
    const timer = board.chip.peripherals[0x40054];
    const write = timer.writeUint32.bind(timer);
    let hold = 0; // us that the core is held up: an erase takes 45 ms and more, a program 0.4
    timer.writeUint32 = (offset, value) => {
        if (offset === 0x10 && hold > 0) {
            board.clock.tick(1000 * hold);
            hold = 0;
        }
        write(offset, value);
    };
    for (const us of [213, 437, 999.4, 45031, 180017]) {
        hold = us;
        board.run(board.nowUs + us + 1000);
        assert.equal(hold, 0);
        assertInPhase(sampledBeforeTheEnd(board, 20), `after ${us} us`);
    }
    assert.equal(board.starts, 1);
});

test('reading flash while it is not mapped is a fault, writing to it always', () => {
    const board = booted();
    assert.throws(() => board.chip.writeUint32(0x10000000, 0), Fault);
    board.chip.xip = false;
    assert.throws(() => board.chip.readUint32(0x10000100), Fault);
    assert.throws(() => board.run(board.nowUs + 1000), Fault); // the main loop is in flash
});

test('the watchdog bites when the main loop stands still, and every axis starts with that fault, motors off', () => {
    const board = booted();
    board.run(board.nowUs + 20e3);
    board.hang();
    const hungAt = board.nowUs;
    board.runWhile(() => board.starts === 1, 1e6);
    assert.equal(board.starts, 2);
    assert.ok(board.nowUs - hungAt < 400e3, `bit after ${board.nowUs - hungAt} us`);
    assert.ok(board.waitForUsb());
    for (let axis = 0; axis < 4; axis++) {
        const { mode, fault } = board.axis(axis);
        assert.deepEqual({ mode, fault }, { mode: 0, fault: WATCHDOG_FAULT });
        assert.equal(board.plant.duty(axis), 0);
    }
});

test('the watchdog bites when interrupts stay off, too', () => {
    const board = booted();
    const { core } = board.chip;
    board.runWhile(() => core.IPSR !== 0, 1000);
    board.chip.writeUint16(NO_PROGRAM, 0xe7fe); // b .
    core.PM = true;
    core.PC = NO_PROGRAM;
    core.waiting = false;
    board.runWhile(() => board.starts === 1, 1e6);
    assert.equal(board.starts, 2);
});

test('a damaged second stage leads into USB boot, not into the image', () => {
    const board = booted();
    board.flash.bytes[17] ^= 4;
    board.reset();
    board.run(board.nowUs + 5e3);
    assert.ok(board.bootloader);
});

test('the bridges coast until the image drives them, and brake when it has nothing to do', () => {
    const board = loadBoard(root, { motor });
    const output = () => [4, 5, 6, 7, 8, 9, 10, 11].map((pin) => board.chip.output(pin));
    assert.deepEqual(output(), [0, 0, 0, 0, 0, 0, 0, 0]);
    assert.ok(board.waitForUsb());
    board.run(board.nowUs + 1000);
    assert.deepEqual(output(), [1, 1, 1, 1, 1, 1, 1, 1]);
});

test('control goes on at its rate: one step every 200 us, never more than 2 us late', () => {
    const board = booted();
    const handler = symbol(elf, 'control_interrupt') & ~1;
    const { chip } = board;
    const at = [];
    const enter = chip.core.exceptionEntry.bind(chip.core);
    chip.core.exceptionEntry = (exception) => {
        enter(exception);
        if ((chip.core.PC & ~1) === handler) at.push(board.clock.nanos / 1000);
    };
    board.run(board.nowUs + 20e3);
    const gaps = at.slice(1).map((time, i) => time - at[i]);
    assert.ok(at.length >= 99, `${at.length} steps in 20 ms`);
    assert.ok(gaps.every((gap) => Math.abs(gap - 200) <= 2), `gaps from ${Math.min(...gaps)} to ${Math.max(...gaps)} us`);
});
