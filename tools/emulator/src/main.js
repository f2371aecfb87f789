// The emulated board for people and for the board tests: the options and ports of the desktop board's process.
import path from 'node:path';
import { fileURLToPath } from 'node:url';
import { parseArgs } from 'node:util';

import { loadBoard } from './board.js';
import { motorConstants } from './plant.js';
import { SimLink } from './simlink.js';
import { UsbIpServer } from './usbip.js';

const root = path.resolve(path.dirname(fileURLToPath(import.meta.url)), '../../..');
const USAGE = 'usage: board --usbip PORT --sim PORT [--flash FILE] [--axes 4] [--rate 5000] [--serial 16 HEX DIGITS] ' +
    '[--realtime] [--parent PID] [--build FOLDER] [--revision B1|B2]';

function fail(message, status) {
    process.stderr.write(`emulated board: ${message}\n`);
    process.exit(status);
}

function options() {
    try {
        const { values } = parseArgs({ options: {
            usbip: { type: 'string' }, sim: { type: 'string' }, flash: { type: 'string' }, axes: { type: 'string' },
            rate: { type: 'string' }, serial: { type: 'string' }, realtime: { type: 'boolean' }, parent: { type: 'string' },
            build: { type: 'string' }, revision: { type: 'string' },
        } });
        if (values.usbip === undefined || values.sim === undefined) fail(`--usbip and --sim are needed\n${USAGE}`, 2);
        return values;
    } catch (error) {
        return fail(`${error.message}\n${USAGE}`, 2);
    }
}

/** The flash chip's unique id: the digits given, or the name's own bytes. */
function chipId(serial) {
    if (serial === undefined) return undefined;
    const bytes = /^[0-9A-F]{16}$/i.test(serial) ? Buffer.from(serial, 'hex') : Buffer.from(serial.padEnd(8, '-').slice(0, 8));
    return [...bytes];
}

async function main() {
    const values = options();
    let board;
    try {
        board = loadBoard(root, { build: values.build, revision: values.revision, flashFile: values.flash ?? null, id: chipId(values.serial),
            motor: motorConstants(path.join(root, 'firmware/port/simulated/motor.c')) });
    } catch (error) {
        fail(error.message, 1);
    }
    const booted = board.waitForUsb();
    if (!booted) fail('the image does not come up on USB', 1);
    const startUs = Math.ceil(board.nowUs / 1000) * 1000;
    board.run(startUs);
    const usbip = new UsbIpServer(board);
    const link = new SimLink(board, usbip, { realtime: values.realtime ?? false, startUs });
    const ports = { usbip: await usbip.listen(Number(values.usbip)), sim: await link.listen(Number(values.sim)) };
    link.onQuit = () => process.exit(0);
    process.on('SIGTERM', () => process.exit(0));
    process.on('SIGINT', () => process.exit(0));
    if (values.parent) setInterval(() => process.ppid === Number(values.parent) || process.exit(0), 500);
    const serial = board.flash.id.map((byte) => byte.toString(16).toUpperCase().padStart(2, '0')).join('');
    process.stdout.write(`${JSON.stringify({ ...ports, serial, axes: 4, rate: 5000 })}\n`);
}

await main();
