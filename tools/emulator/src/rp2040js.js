// The parts of rp2040js that we build on. Some are not in its public index, so they come by path.
export { RP2040 } from '../node_modules/rp2040js/dist/esm/rp2040.js';
export { CortexM0Core } from '../node_modules/rp2040js/dist/esm/cortex-m0-core.js';
export { SimulationClock } from '../node_modules/rp2040js/dist/esm/clock/simulation-clock.js';
export { BasePeripheral } from '../node_modules/rp2040js/dist/esm/peripherals/peripheral.js';
export { RPPADS } from '../node_modules/rp2040js/dist/esm/peripherals/pads.js';
export { RPPIO, StateMachine } from '../node_modules/rp2040js/dist/esm/peripherals/pio.js';
export { RPPWM } from '../node_modules/rp2040js/dist/esm/peripherals/pwm.js';
export { RPTimer } from '../node_modules/rp2040js/dist/esm/peripherals/timer.js';
export { RPUSBController } from '../node_modules/rp2040js/dist/esm/peripherals/usb.js';
export { RPWatchdog } from '../node_modules/rp2040js/dist/esm/peripherals/watchdog.js';
