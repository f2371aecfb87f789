import fs from 'node:fs';

const MOTOR_PIN = 4;                         // of axis 0: P, then N; two pins an axis
const ENCODER_PIN = [0, 2, 12, 14];          // A of each axis, B beside it
const SENSE_PINS = [22, 24, 25];             // of the multiplexer, lowest first
const DEAD_TIME_US = 0.45;                   // DRV8833: neither side conducts while it switches over
const SHUNT_OHM = 0.47;
const ESTOP_PIN = 16;
const SUPPLY_ADDRESS = 4;
const FAULT_ADDRESS = 5;
const ADC_VOLT = 3.3;
const QUADRATURE = [0b00, 0b10, 0b11, 0b01]; // B << 1 | A as the motor turns forward

export const STEP_US = 25;
const LOG_US = 1000;

/** The constants of the desktop board's motor, from its source: both boards turn the same motor. */
export function motorConstants(file) {
    const text = fs.readFileSync(file, 'utf8');
    const get = (name) => {
        const found = text.match(new RegExp(`^#define\\s+${name}\\s+([0-9.]+)`, 'm'));
        if (!found) throw new Error(`${file} does not define ${name}`);
        return Number(found[1]);
    };
    return { freeSpeed: get('FREE_SPEED'), timeConstant: get('TIME_CONSTANT'), sliding: get('SLIDING'),
        static: get('STATIC'), stribeck: get('STRIBECK'), stall: get('STALL'), chop: get('CHOP') };
}

/** One geared motor, positions in counts; the equations of firmware/port/simulated/motor.c. */
class Motor {
    constructor(constants) {
        this.k = constants;
        this.position = 0;
        this.speed = 0;
        this.current = 0; // mA
    }

    /** `duty` -1 to 1; a motor that coasts has no current. */
    step(duty, coasts) {
        const { k } = this;
        const dt = STEP_US * 1e-6;
        const most = k.chop / k.stall; // the driver cuts the current off there
        const drive = coasts ? 0 : Math.max(-most, Math.min(most, duty - this.speed / k.freeSpeed));
        this.current = k.stall * drive;
        if (this.speed === 0 && Math.abs(duty) <= k.static) return;
        const direction = Math.sign(this.speed !== 0 ? this.speed : duty);
        const friction = k.sliding + (k.static - k.sliding) * Math.exp(-Math.abs(this.speed) / k.stribeck);
        const speed = this.speed + (((drive - direction * friction) * k.freeSpeed) / k.timeConstant) * dt;
        this.speed = speed * direction < 0 ? 0 : speed; // friction stops a motor, it does not turn it round
        this.position += this.speed * dt;
    }
}

/** The board's four motors with their bridges, encoders and current sense, in the time of the world. */
export class Plant {
    constructor(constants) {
        this.motors = ENCODER_PIN.map(() => new Motor(constants));
        this.pinZero = [0, 0, 0, 0]; // count at which the pins are both low
        this.pins = [0, 0, 0, 0];    // the count that the pins show
        this.supplyVolt = 6;
        this.driverFault = false;
        this.estopClosed = false;
        this.ills = ENCODER_PIN.map(() => 'well');
        this.encoders = ENCODER_PIN.map(() => ({ scale: 1, from: 0 })); // counts for each one shown, beginning there
        this.timeUs = 0;
        this.log = [];               // true positions, counts Q8, one row a millisecond
        this.chip = null;
    }

    /** Wires a chip that has just started; it will be stepped by its clock from here on. */
    attach(chip) {
        this.chip = chip;
        this.clock = chip.clock;
        this.alarm = this.clock.createAlarm(() => {
            this.alarm.schedule(STEP_US * 1000);
            this.step();
        });
        this.alarm.schedule(STEP_US * 1000);
        this.edges = [];
        this.edgeAlarm = this.clock.createAlarm(() => this.#edge());
        this.motors.forEach((_, axis) => this.#show(axis));
        chip.drive(ESTOP_PIN, !this.estopClosed); // its pull-up holds it high
        chip.adc.onADCRead = (channel) => {
            chip.adc.currentChannel = channel;
            chip.adc.channelValues[3] = this.#sensed();
            chip.adc.sampleAlarm.schedule(chip.adc.sampleTime * 1000);
        };
    }

    detach() {
        this.chip = null;
    }

    /** Signed part of the period in which the bridge drives, and whether it leaves the motor alone. */
    #bridge(axis) {
        const p = this.chip.output(MOTOR_PIN + 2 * axis);
        const n = this.chip.output(MOTOR_PIN + 2 * axis + 1);
        const on = Math.abs(p - n);
        const lost = on > 0 && on < 1 ? Math.min(on, DEAD_TIME_US * this.chip.pwm.frequency(MOTOR_PIN + 2 * axis) * 1e-6) : 0;
        return { duty: Math.sign(p - n) * (on - lost), coasts: p === 0 && n === 0 };
    }

    #sensed() {
        const address = SENSE_PINS.reduce((sum, pin, bit) => sum | (this.chip.output(pin) << bit), 0);
        const adc = (volt) => Math.max(0, Math.min(4095, Math.round((volt / ADC_VOLT) * 4096)));
        if (address === SUPPLY_ADDRESS) return adc((this.supplyVolt * 3.9) / 13.9);
        if (address === FAULT_ADDRESS) return adc(this.driverFault ? 0 : ADC_VOLT);
        if (address > 3) return 0;
        const p = this.chip.level(MOTOR_PIN + 2 * address);
        const n = this.chip.level(MOTOR_PIN + 2 * address + 1);
        if (p === n) return 0; // it brakes or coasts: nothing flows through the shunt
        const milliamp = this.motors[address].current * (p ? 1 : -1);
        return adc(milliamp * 1e-3 * SHUNT_OHM);
    }

    /** STEP_US on. */
    step() {
        const running = this.chip !== null;
        this.motors.forEach((motor, axis) => {
            const { duty, coasts } = running ? this.#bridge(axis) : { duty: 0, coasts: true };
            const { position } = motor;
            motor.step(this.ills[axis] === 'reversed' ? -duty : duty, coasts);
            if (this.ills[axis] === 'blocked') Object.assign(motor, { position, speed: 0 });
            this.#turn(axis);
        });
        if (running && this.edges.length > 0) this.#schedule();
        this.timeUs += STEP_US;
        if (this.timeUs % LOG_US === 0) this.log.push(this.motors.map((_, axis) => this.trueQ8(axis)));
    }

    #count(axis) {
        const count = Math.floor(this.motors[axis].position) - this.pinZero[axis];
        const { scale, from } = this.encoders[axis];
        return scale === 1 ? count : from + Math.trunc((count - from) / scale);
    }

    /** Every edge on its own: the first at once, the others spread over the step. */
    #turn(axis) {
        const count = this.#count(axis);
        const steps = Math.abs(count - this.pins[axis]);
        if (steps === 0) return;
        const way = Math.sign(count - this.pins[axis]);
        if (this.chip === null) {
            this.pins[axis] = count;
            return;
        }
        for (let i = 0; i < steps; i++) {
            this.edges.push({ at: this.clock.nanos + (i * STEP_US * 1000) / steps, axis, way });
        }
    }

    #schedule() {
        this.edges.sort((a, b) => a.at - b.at);
        this.#edge();
    }

    #edge() {
        while (this.edges.length > 0 && this.edges[0].at <= this.clock.nanos) {
            const { axis, way } = this.edges.shift();
            this.pins[axis] += way;
            this.#show(axis);
        }
        if (this.edges.length > 0) this.edgeAlarm.schedule(this.edges[0].at - this.clock.nanos);
    }

    #show(axis) {
        const state = QUADRATURE[((this.pins[axis] % 4) + 4) % 4];
        this.chip.drive(ENCODER_PIN[axis], (state & 1) !== 0);
        this.chip.drive(ENCODER_PIN[axis] + 1, (state & 2) !== 0);
    }

    /** What drives the motor now, -1 to 1. */
    duty(axis) {
        return this.chip === null ? 0 : this.#bridge(axis).duty;
    }

    trueQ8(axis) {
        return Math.round(this.motors[axis].position * 256);
    }

    /** What is wrong with an axis from now on, as on the desktop board; the encoder goes on from what it shows. */
    inject(axis, ill) {
        const shown = this.#count(axis);
        this.ills[axis] = ill;
        this.driverFault = this.ills.includes('driver'); // these three are one line of the board each
        this.supplyVolt = this.ills.includes('supply') ? 2.5 : 6;
        this.estopClosed = this.ills.includes('estop');
        this.chip?.drive(ESTOP_PIN, !this.estopClosed);
        this.encoders[axis] = { scale: { coarse: 8, unplugged: Infinity }[ill] ?? 1, from: shown };
        this.pinZero[axis] = Math.floor(this.motors[axis].position) - shown;
    }

    /** Puts a motor, at rest, to a true position: the encoder does not notice. */
    place(axis, q8) {
        const before = Math.floor(this.motors[axis].position);
        this.motors[axis].position = q8 / 256;
        this.motors[axis].speed = 0;
        this.pinZero[axis] += Math.floor(this.motors[axis].position) - before;
    }
}
