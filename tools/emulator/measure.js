// Counts cycles: runs build/rp2040/cycles.bin and prints one JSON object, per kind the number of measurements, the worst and
// the mean in cycles; and the address of each conditional branch met with the ways it went: 1 taken, 2 not, 3 both.
import fs from 'node:fs';
import path from 'node:path';
import { fileURLToPath } from 'node:url';

import { Chip } from './src/chip.js';
import { Flash } from './src/flash.js';
import { SimulationClock } from './src/rp2040js.js';

const KINDS = [
  'step_tip', 'step_other', 'watch', 'guard', 'motion', 'onset', 'step_plays', 'watch_plays',
  'step_undoes', 'watch_undoes', 'lookup', 'lookup_yardstick', 'empty',
];
const LOOKUP = KINDS.indexOf('lookup'); // and what follows may run from flash
const LIMIT_S = 150; // of emulated time
const TAKEN = 1;
const NOT_TAKEN = 2;

const root = path.resolve(path.dirname(fileURLToPath(import.meta.url)), '../..');
const build = path.join(root, 'build/rp2040');

function measure() {
    const flash = new Flash();
    flash.bytes.set(fs.readFileSync(path.join(build, 'cycles.bin')));
    const bootrom = new Uint32Array(4096);
    new Uint8Array(bootrom.buffer).set(fs.readFileSync(path.join(build, 'emulator/bootrom.bin')));
    const clock = new SimulationClock();
    const chip = new Chip({ clock, flash, bootrom });
    const { core } = chip;
    const seen = KINDS.map(() => ({ count: 0, worst: 0, sum: 0 }));
    const branches = new Map(); // address -> ways
    let kind = null;
    let start = 0;
    let done = false;
    let fetched = 0;            // from flash, while the control step or an onset update was measured
    chip.onBreakpoint = (code) => {
        if (code === 0xd0) {
            kind = core.registers[0];
            start = core.cycles;
        } else if (code === 0xd1) {
            const cycles = core.cycles - start;
            const entry = seen[kind];
            entry.count += 1;
            entry.sum += cycles;
            entry.worst = Math.max(entry.worst, cycles);
            kind = null;
        } else if (code === 0xd2) {
            done = true;
        } else {
            throw new Error(`breakpoint ${code} at 0x${core.PC.toString(16)}: the program gave up`);
        }
    };
    while (!done && clock.nanos < LIMIT_S * 1e9) {
        const pc = core.PC;
        clock.tick(core.executeInstruction() * chip.cycleNanos);
        if (kind === null) continue;
        if (pc >>> 24 === 0x10 && kind < LOOKUP) fetched += 1;
        const opcode = chip.readUint16(pc);
        if (opcode >>> 12 === 0xd && (opcode & 0xf00) < 0xe00) {
            branches.set(pc, (branches.get(pc) ?? 0) | (core.PC === pc + 2 ? NOT_TAKEN : TAKEN));
        }
    }
    if (!done) throw new Error('the program does not end');
    const empty = seen[KINDS.indexOf('empty')].worst;
    const result = {};
    seen.forEach(({ count, worst, sum }, i) => {
        if (count > 0 && KINDS[i] !== 'empty') result[KINDS[i]] = { count, worst: worst - empty, mean: Math.round(sum / count - empty) };
    });
    return { ...result, seen: [...branches], flash_fetches: fetched };
}

process.stdout.write(`${JSON.stringify(measure())}\n`);
