"""The guards that docs/safety.md counts on, each with what the source is without it and the test that then fails.

tools/mutants.py takes out one after the other. A guard is named by the text that makes it; a text that is there no
longer, or twice, is an error.
"""

from __future__ import annotations

from dataclasses import dataclass

RANDOM = "tests/c/test_random.c::test_whatever_happens_an_axis_keeps_its_word"
SAFETY, AXIS, LINK, STORE, STOPS, SIGHT = (
    f"tests/c/test_{name}.c::test_" for name in ("safety", "axis", "link", "store", "stop", "sight")
)
IMAGE = "tools/emulator/test/image.test.js::"
EVERY_POINT = "tests/board/test_every_point.py::test_whatever_goes_wrong_at_any_point"
COMMISSION, COMMANDS = (f"tests/board/test_{name}.py::test_" for name in ("commission", "commands"))
PAGE, C_FILES = (f"tests/host/test_{name}.py::test_" for name in ("safety_page", "firmware_sources"))
UPDATE, UPDATED = "tests/c/test_update.c::test_", "tests/firmware/test_emulated_update.py::test_"
EMULATED, BUILT = (f"tests/firmware/test_{name}.py::test_" for name in ("emulated_board", "image"))

ASK, GUARD, REST, SEEN, STOP, APP, COMMAND, TABLES, SETTINGS = (
    f"firmware/app/src/tl_{name}.c"
    for name in ("axis_ask", "axis_guard", "axis_rest", "sight", "stop", "app", "command", "tables", "settings")
)
HEADERS = "firmware/app/include/tautline/"
RP2040 = "firmware/port/rp2040/"
FLASH_STORE = "firmware/app/src/tl_store.c"
LOGGED, LOG = "tests/c/test_fault_log.c::test_", "firmware/app/src/tl_fault_log.c"
NEW, BOOT = "firmware/app/src/tl_update.c", "firmware/app/src/tl_boot.c"
HOST = "host/tautline/"


@dataclass(frozen=True)
class Guard:
    """`changes`: (file, text as it is, text without the guard). `board`: what a test of tests/board then runs on."""

    name: str
    test: str
    changes: tuple[tuple[str, str, str], ...]
    board: str = "desktop"


def _one(name: str, test: str, file: str, before: str, after: str = "", board: str = "desktop") -> Guard:
    return Guard(name, test, ((file, before, after),), board)


# -- the control step and what is asked of it: hours of a board's life fail without each of these ---------------------

_LIVED = (
    _one("duty within its limit", RANDOM,
         HEADERS + "tl_servo.h", "if (sum > limit || sum < -limit) {", "if (sum > 65536) {"),
    _one("a fault switches off", RANDOM,
         REST, "    tl_axis_off(axis);\n    axis->guard.lapsed", "    axis->guard.lapsed"),
    _one("off is off", RANDOM, REST, "    tl_actuator_release(&axis->motor);\n"),
    _one("weak without a reference", RANDOM,
         ASK, "axis->referenced ? axis->limits.duty_q15 : low_duty(axis)", "axis->limits.duty_q15"),
    _one("weak homing", RANDOM,
         ASK, "request->duty_q15 > 0 ? request->duty_q15 : low_duty(axis)", "axis->limits.duty_q15"),
    Guard("a weak check", RANDOM,
          ((GUARD, "#define CHECK_PUSH    2621", "#define CHECK_PUSH    32768"),
           (GUARD, "most < axis->settings.low_duty_q15 ?", "true ?"))),
    _one("a reference to follow or calibrate", RANDOM, ASK, "reason == 0 && !axis->referenced ?", "false ?"),
    _one("a reference to move", RANDOM, ASK, "    if (!axis->referenced) {", "    if (false) {"),
    _one("a check before driving", RANDOM, ASK, "        if (axis->checked) {", "        if (true) {"),
    Guard("a check that sees swapped wires", RANDOM,
          ((GUARD, "way < -CHECK_MOVED, TL_WIRE_FAULT_REVERSED", "false, TL_WIRE_FAULT_REVERSED"),
           (GUARD, "!trial->moved, TL_WIRE_FAULT_UNMOVED", "false, TL_WIRE_FAULT_UNMOVED"),
           (GUARD, "!trial->right_scale, TL_WIRE_FAULT_SCALE", "false, TL_WIRE_FAULT_SCALE"))),
    _one("an encoder that jumps", RANDOM,
         HEADERS + "tl_actuator.h", ">= 2U * TL_ACTUATOR_JUMP", ">= 0xFFFFFFFFU"),
    _one("a jump takes the reference", RANDOM, REST, "(BIT(ENCODER) | BIT(EDGES)", "(BIT(EDGES)"),
    _one("lost edges are asked for", RANDOM, APP, "        poll_encoders(app, now_us);\n"),
    _one("lost edges take the reference", RANDOM, REST, "(BIT(ENCODER) | BIT(EDGES)", "(BIT(ENCODER)"),
    _one("a pause is no jump", RANDOM,
         HEADERS + "tl_actuator.h", "(elapsed_us < 1000000U ? elapsed_us : 1000000U)", "0U"),
    _one("stall", RANDOM, GUARD, "fails(axis, stalls, TL_WIRE_FAULT_STALL", "fails(axis, false, TL_WIRE_FAULT_STALL"),
    _one("asking again does not hide a stall", RANDOM, ASK,
         "    axis->guard.still_ms = 0; //", "    axis->guard.still_ms = 0;\n    axis->guard.pushed_ms = 0; //"),
    _one("following error", RANDOM, GUARD, "!within(error, axis->limits.following_error_q8)", "false"),
    _one("oscillation", RANDOM, GUARD, "return guard->swing >= SWING_MOST;", "return false;"),
    _one("driver", RANDOM, GUARD, "guard->driver_ms >= DRIVER_MS", "false"),
    _one("supply", RANDOM, GUARD, "guard->supply_ms >= SUPPLY_MS", "false"),
    _one("current", RANDOM, GUARD, "most > 0 && guard->current_mean_q8 > most * 256", "false"),
    _one("a host that is silent", RANDOM, GUARD, "--axis->guard.patience == 0U", "false"),
    _one("limits within the settings", RANDOM, ASK, "!are_within(limits, &axis->settings)", "false"),
    _one("the range", RANDOM,
         REST, "    axis->plan.low = low;", "    low = -TL_AXIS_RANGE_MAX;\n    axis->plan.low = low;"),
    _one("the speed of a move", RANDOM,
         ASK, "axis->plan.move.speed = speed < most ? speed : most;", "axis->plan.move.speed = 4 * most + 0 * speed;"),
    _one("a path from where the motor is", RANDOM, ASK,
         "    tl_axis_settle(axis);\n    tl_actuator_reset(&axis->motor, axis->q);\n    tl_axis_admit(axis);\n"
         "    axis->guard.current_mean_q8", "    axis->guard.current_mean_q8"),
    _one("arrived is there", RANDOM, GUARD, "within(axis->q - target, axis->settings.arrive_q8)", "true"),
)  # fmt: skip

# -- the same, and what lies around it: one test each -----------------------------------------------------------------

_APP = (
    _one("an encoder that shows nothing",
         SAFETY + "an_encoder_lost_next_to_its_target_is_noticed_and_its_position_not_trusted",
         GUARD, "pushes || more > 2 * CHECK_PUSH", "pushes || more > 99 * CHECK_PUSH"),
    _one("a stall adds up", SAFETY + "an_encoder_lost_while_its_path_goes_to_and_fro_is_noticed", GUARD,
         "pushes ? guard->pushed_ms + 1 : guard->pushed_ms - 1;", "pushes ? guard->pushed_ms + 1 : 0;"),
    _one("momentum tells a dropout", SIGHT + "a_dropout_at_speed_is_fifty_counts_at_most",
         HEADERS + "tl_sight.h", "#define TL_SIGHT_MOST 6 ", "#define TL_SIGHT_MOST 60 "),
    _one("one line alone is no motion", SIGHT + "a_dropout_at_speed_is_fifty_counts_at_most",
         SEEN, "(2 * TL_COUNT_ONE)", "(1 * TL_COUNT_ONE)"),
    _one("a dropout takes the reference", SIGHT + "a_dropout_at_speed_is_fifty_counts_at_most",
         GUARD, "    guard->blind = true;\n"),
    _one("a count to and fro is no way", SIGHT + "a_line_that_dies_at_any_speed_leaves_no_position",
         REST, " || tl_actuator_unseen_ms(&axis->motor) >= NO_WAY_MS", ""),
    _one("a motor that runs down is watched", SIGHT + "a_dropout_while_it_runs_down_leaves_no_position",
         GUARD, "off ? guard->off_ms < RUN_DOWN_MS", "off ? false"),
    _one("what brakes a motor is no dropout", SIGHT + "no_sound_motion_is_taken_for_a_dropout",
         SEEN, "less = MARGIN + s->doubt;", "less = 0;"),
    _one("an unseen motion takes the reference", SAFETY + "another_fault_while_nothing_is_seen_leaves_no_position",
         REST, "unseen ? OF_POSITION | OF_MOTION : OF_POSITION", "unseen ? OF_POSITION : OF_POSITION"),
    _one("off in the dark takes the reference",
         SAFETY + "an_encoder_lost_just_before_switching_off_leaves_no_position",
         REST, "axis->referenced = axis->referenced && !axis->guard.blind;", ""),
    _one("a drive that grew in the dark takes the reference",
         SAFETY + "an_encoder_lost_next_to_its_target_leaves_no_position_when_switched_off",
         GUARD, "blind = pushes || more > STICKS;", "blind = pushes;"),
    _one("growth counts from rest", SAFETY + "a_sound_motor_that_sticks_at_every_count_is_no_stall",
         GUARD, "        guard->seen_duty += (axis->motor.duty - guard->seen_duty) / SETTLED;", "       "),
    _one("a driver that chops pushes", SAFETY + "a_driver_that_chops_its_current_at_a_blocked_motor_is_a_stall",
         GUARD, "(chops_ma > 0 && size_ma >= chops_ma)", "(chops_ma > 0 && size_ma < 0)"),
    _one("the port's current limit", SAFETY + "the_default_current_limit_is_below_the_drivers_own",
         ASK, ".current_ma = port->driver_ma - port->driver_ma / 16,", ".current_ma = 1000,"),
    _one("the supply is told", SAFETY + "a_driver_fault_and_a_low_supply_are_faults_and_told",
         COMMAND, "out->supply_mv = axis->guard.supply_mv;", "out->supply_mv = 0;"),
    _one("slow oscillation", SAFETY + "proportional_gain_alone_swings_at_full_duty_until_it_is_a_fault",
         GUARD, "tl_path_rests(&axis->path) ? 1U : SWING_REST", "SWING_REST"),
    _one("a dead encoder is seen", SAFETY + "swapped_wires_a_dead_encoder_and_a_wrong_scale_are_told_apart",
         GUARD, "!trial->moved, TL_WIRE_FAULT_UNMOVED", "false, TL_WIRE_FAULT_UNMOVED"),
    _one("a wrong scale is seen", SAFETY + "swapped_wires_a_dead_encoder_and_a_wrong_scale_are_told_apart",
         GUARD, "!trial->right_scale, TL_WIRE_FAULT_SCALE", "false, TL_WIRE_FAULT_SCALE"),
    _one("homing gives up", SAFETY + "homing_gives_up_where_no_end_comes",
         GUARD, "fails(axis, gone > trial->reach,", "fails(axis, false,"),
    _one("an end is the reference", SAFETY + "homing_finds_the_end_at_low_drive_and_is_referenced",
         GUARD, "    axis->q = trial->end;\n"),
    _one("a weak jog", SAFETY + "a_jog_needs_no_reference_and_is_weak", ASK,
         "    begin(axis, low_duty(axis));", "    begin(axis, axis->limits.duty_q15);"),
    _one("weak until commissioned", SAFETY + "a_motor_that_nobody_commissioned_is_weak_and_slow",
         ASK, "    if (from->commissioned == 0U) {", "    if (from->commissioned == 7U) {"),
    _one("settings are stored", SAFETY + "settings_outlive_the_power_and_no_host_widens_them",
         SETTINGS, "if (!tl_store_write(port, TL_STORE_SETTINGS, 0U, scratch, TL_WIRE_AXES_MAX * FRAME_SIZE)) {",
         "if (false && scratch[0] == FRAME_SIZE) {"),
    _one("homing lapses", SAFETY + "homing_and_checks_end_with_the_host_too", GUARD,
         "MODE_MOVE || axis->mode == TL_WIRE_MODE_HOME;\n}", "MODE_MOVE;\n}"),
    _one("a sender that is silent", AXIS + "a_silent_sender_brings_the_axis_to_rest_and_holds",
         GUARD, "return tl_axis_is_following(axis) || axis->mode == TL_WIRE_MODE_MOVE ||",
         "return axis->mode == TL_WIRE_MODE_MOVE ||"),
    _one("a sender that is silent after a late request",
         AXIS + "a_sender_that_is_silent_after_a_late_request_is_noticed",
         ASK, "return (end_us > now_us ?", "return (end_us != now_us ?"),
    _one("a hold that ends", SAFETY + "a_motor_that_holds_alone_lets_go_slowly",
         GUARD, "++guard->alone_ms < axis->settings.hold_ms", "++guard->alone_ms > 0"),
    _one("a hold that ends slowly", SAFETY + "a_motor_that_holds_alone_lets_go_slowly",
         GUARD, "guard->sink = (size >> 10) + 1;", "guard->sink = size + 1;"),
    _one("a camera that is silent", AXIS + "a_calibration_without_frames_ends_in_the_safe_state",
         "firmware/estimator/src/tl_motion.c", "m->timeout_ticks > 0 && ++m->quiet_ticks > m->timeout_ticks", "false"),
    _one("a bus that is gone", AXIS + "losing_the_bus_while_following_comes_to_rest_at_once",
         APP, "        tl_axis_silence(axis);\n"),
    _one("safe_stop", AXIS + "safe_stop_works_from_every_state",
         COMMAND, "        tl_axis_fail(axis, TL_WIRE_FAULT_STOPPED, 0, now_us);\n", "        (void)now_us;\n"),
    _one("a group goes off", STOPS + "an_axis_takes_its_group_with_it",
         STOP, "        tl_stop_group(axis, now_us);\n", "        (void)now_us;\n"),
    _one("a fault that is cleared at once", STOPS + "a_fault_that_is_cleared_at_once_takes_its_group_all_the_same",
         ASK, "    tl_stop_group(axis, now_us); //", "    (void)now_us; //"),
    _one("a group stays off", STOPS + "a_group_is_driven_again_once_the_first_fault_is_cleared",
         ASK, "if (tl_stop_group_has_fault(axis)) {", "if (false) {"),
    _one("the stop input", STOPS + "the_stop_input_switches_every_axis_off_and_stays",
         STOP, "axis->guard.estop_ms == ESTOP_MS &&", "false &&"),
    _one("a stop that stays", STOPS + "the_stop_input_switches_every_axis_off_and_stays",
         ASK, "if (tl_stop_is_pressed(axis)) {", "if (false) {"),
    _one("an open contact", STOPS + "a_stop_input_that_opens_stops_where_it_is_wired_so",
         STOP, "closed != (axis->settings.estop == TL_WIRE_ESTOP_OPEN)", "closed"),
    _one("late control steps", AXIS + "late_control_steps_fault_a_driven_axis_only",
         APP, "since_us > LATE_FAULT &&", "false &&"),
    _one("the watchdog watches the control step", AXIS + "the_watchdog_is_fed_only_while_control_steps_go_on",
         APP, "if (app->steps != app->steps_fed) {", "{"),
    _one("a restart by the watchdog is told", AXIS + "a_watchdog_restart_is_told_and_latched",
         APP, "port->boot == TL_WIRE_BOOT_WATCHDOG", "false"),
    Guard("a stored table is whole", STORE + "a_flipped_bit_falls_back_to_the_older_table",
          ((FLASH_STORE, "found.whole = crc_of(port, found.blob, found.size) == found.crc;", "found.whole = true;"),
           ("common/src/tl_table.c", "tl_get(blob + size - 4, 4) != tl_crc32(0, blob, size - 4)", "size < 4"))),
    _one("the older slot is written", STORE + "a_power_cut_at_any_operation_leaves_the_old_or_the_new_table",
         FLASH_STORE, "kept < offset_of(axis, 1U) ? 1U : 0U", "kept < offset_of(axis, 1U) ? 0U : 1U"),
    _one("the table in use stays", STORE + "the_table_in_use_stays_where_the_newer_one_was_refused",
         FLASH_STORE, "kept == 0U ? older", "true ? older"),
    _one("erased flash is read back", STORE + "what_flash_did_not_take_is_told_and_the_table_in_use_stays",
         FLASH_STORE, " && is_blank(port, offset, TL_PORT_FLASH_SECTOR);", ";"),
    _one("programmed flash is read back", STORE + "what_flash_did_not_take_is_told_and_the_table_in_use_stays",
         FLASH_STORE, " && holds(port, offset, page, sizeof(page));", ";"),
    _one("the integral's limit", SAFETY + "the_integral_is_no_more_than_the_drive_may_be",
         HEADERS + "tl_servo.h", "tl_clamp(integral + error * servo->integral_step, -most, most)",
         "tl_clamp(integral + error * servo->integral_step, -8 * most, 8 * most)"),
    _one("a slow jog", SAFETY + "jogs_and_homing_go_at_half_the_speed_at_most", ASK,
         """    begin(axis, low_duty(axis));
    set_speed(axis, request->speed_q8_s, axis->plan.travel.speed / 10, axis->plan.travel.speed / 2);""",
         """    begin(axis, low_duty(axis));
    set_speed(axis, request->speed_q8_s, axis->plan.travel.speed / 10, axis->plan.travel.speed);"""),
    _one("slow homing", SAFETY + "jogs_and_homing_go_at_half_the_speed_at_most", ASK,
         """low_duty(axis));
    set_speed(axis, request->speed_q8_s, axis->plan.travel.speed / 10, axis->plan.travel.speed / 2);
    axis->plan.move_target = tl_reference_q""", """low_duty(axis));
    set_speed(axis, request->speed_q8_s, axis->plan.travel.speed / 10, axis->plan.travel.speed);
    axis->plan.move_target = tl_reference_q"""),
    _one("a damaged upload touches nothing",
         STORE + "a_damaged_upload_leaves_the_table_in_use_though_flash_has_lost_it",
         "firmware/app/src/tl_tables.c", "reason = tl_table_check_blob(blob, size, axis);", "reason = TL_TABLE_OK;"),
    _one("damaged tables are told", STORE + "both_damaged_is_a_fault_that_can_be_cleared",
         APP, "app->tables.in_use[i].state == TL_WIRE_TABLE_BAD", "false"),
    _one("settings go to the older slot",
         SAFETY + "a_power_cut_while_settings_are_written_leaves_the_old_or_the_new",
         FLASH_STORE, "kept == 0U ? older", "kept == 0U ? 1U - older"),
    _one("stored settings are whole", SAFETY + "damaged_settings_are_a_fault",
         FLASH_STORE, "found.whole = crc_of(port, found.blob, found.size) == found.crc;", "found.whole = true;"),
    _one("damaged settings are told", SAFETY + "damaged_settings_are_a_fault",
         APP, "app->settings == TL_WIRE_STORE_BAD", "false"),
    _one("a refused table changes nothing", SAFETY + "a_refused_table_leaves_the_one_in_use",
         TABLES, "        load(tables, axis); // what flash has: the one that was in use\n",
         "        use(tables, axis, false, false);\n"),
    _one("a table is loaded beside the one in use", "tests/c/test_drive.c::test_the_readme_s_example",
         "firmware/estimator/include/tautline/tl_drive.h", "(uint8_t)(1U - drive->used)", "drive->used"),
    _one("a change stays where the motor was sent",
         "tests/c/test_changes.c::test_nothing_that_is_changed_makes_the_goal_jump_or_leave_the_range",
         "firmware/estimator/src/tl_compensator.c", "tl_add_sat(k->q, tl_compensator_rest(k))", "k->q"),
    _one("the instrument of a table", SAFETY + "a_table_for_another_instrument_is_refused_unless_any_will_do",
         TABLES, "reason == TL_TABLE_OK && !table->any &&", "reason == TL_TABLE_OK && false &&"),
    _one("a half frame ends", LINK + "a_half_frame_costs_nothing_that_comes_later",
         APP, "        poll_half_frame(app, now_us);\n", "        (void)poll_half_frame;\n"),
    _one("a restart waits for rest", LINK + "a_restart_waits_until_the_axes_rest",
         APP, "tl_tables_all_off(app->port, app->axes) || since_us >= REST_MOST_US", "true"),
    _one("a status under the lock", "tests/c/test_app.c::test_a_status_is_of_one_moment", COMMAND,
         "state = port->lock(port->context);\n    out->mode", "state = 0;\n    out->mode"),
    _one("events under the lock", "tests/c/test_app.c::test_no_event_is_lost_to_the_control_step", TABLES,
         """    tl_axis_use_table(&tables->axes[index], found);
    if (is_new) {
        tl_axis_event(&tables->axes[index], TL_WIRE_EVENT_TABLE);
    }
    port->unlock(port->context, state);
""", """    tl_axis_use_table(&tables->axes[index], found);
    port->unlock(port->context, state);
    if (is_new) {
        tl_axis_event(&tables->axes[index], TL_WIRE_EVENT_TABLE);
    }
"""),
    _one("a new table is told", "tests/c/test_app.c::test_no_event_is_lost_to_the_control_step", TABLES,
         "        tl_axis_event(&tables->axes[index], TL_WIRE_EVENT_TABLE);\n", "        (void)0;\n"),
    _one("an image counts when all of it is there", UPDATE + "a_flipped_bit_falls_back_to_the_other_slot",
         BOOT, "tl_boot_crc(flash, slot, found.size) != crc", "false"),
    _one("the slot that runs is not written", UPDATE + "a_power_cut_at_any_operation_of_an_update_leaves_one_that_runs",
         NEW, "update->port->update->slot == 0U ? 1U : 0U;", "update->port->update->slot == 0U ? 0U : 1U;"),
    _one("firmware is on trial", UPDATE + "new_firmware_that_hangs_gives_way_to_the_old_one_for_good",
         BOOT, "(slot != failed || found->confirmed)", "true"),
    _one("a trial that failed is remembered", UPDATE + "new_firmware_that_hangs_gives_way_to_the_old_one_for_good",
         NEW, "        mark(port, free_slot(update), TL_BOOT_FAILED);", "        (void)0;"),
    _one("a host confirms", UPDATE + "new_firmware_runs_from_the_next_start_on_and_is_confirmed_by_a_host",
         NEW, "if (update->heard && since_us", "if (since_us"),
    _one("silent firmware is given up", UPDATE + "new_firmware_that_no_host_has_talked_to_is_given_up",
         NEW, "port->update->trial_ends(port->context, false);", "(void)0;"),
    _one("on trial nothing is overwritten", UPDATE + "on_trial_the_old_one_is_not_overwritten",
         NEW, "    if (update->trial) {\n", "    if (false) {\n"),
    _one("a signature", UPDATE + "nothing_is_erased_for_a_file_that_is_refused",
         NEW, "return is_signed ? TL_WIRE_UPDATE_NONE : TL_WIRE_UPDATE_SIGNATURE;",
         "return is_signed ? TL_WIRE_UPDATE_NONE : TL_WIRE_UPDATE_NONE;"),
    _one("a hash of what flash holds", UPDATE + "a_file_that_ends_early_or_changed_on_its_way_does_not_count",
         NEW, "memcmp(hash, update->hash, sizeof(hash)) != 0", "false"),
    _one("another board's firmware", UPDATE + "nothing_is_erased_for_a_file_that_is_refused",
         NEW, "if (!is_for(update->port, &image)) {", "if (false && !is_for(update->port, &image)) {"),
    _one("firmware for another number of axes", UPDATE + "firmware_for_another_number_of_axes_is_refused",
         NEW, "port->axes < TL_WIRE_AXES_MAX ? sizeof(axes) : 0U", "0U * sizeof(axes)"),
    _one("older firmware by --force alone", UPDATE + "an_older_one_comes_where_it_is_asked_for",
         NEW, "if (!update->any && memcmp", "if (false && memcmp"),
    _one("firmware with every motor off", UPDATE + "nothing_is_erased_for_a_file_that_is_refused",
         NEW, "tl_tables_all_off(update->port, update->axes) ? TL_WIRE_UPDATE_NONE", "true ? TL_WIRE_UPDATE_NONE"),
    _one("firmware is read back", UPDATE + "what_flash_did_not_take_does_not_count",
         NEW, " && holds(port, slot, offset, page);", ";"),
    _one("faults are logged with every motor off", LOGGED + "nothing_is_written_while_a_motor_is_on",
         LOG, "due && may_write && tl_tables_all_off(log->port, log->axes)", "due && may_write"),
    _one("a fault a second", LOGGED + "a_host_that_makes_faults_wears_no_flash",
         LOG, "now_us - log->wrote_us >= AT_MOST_US", "true"),
    _one("a torn page is passed over", LOGGED + "a_power_cut_loses_the_fault_that_was_written_or_the_oldest",
         LOG, "!is_blank(port, log->next)) {", "false) {"),
    _one("codes differ", "tests/c/duplicate_code.c::",
         "common/include/tautline/tl_wire.h", "#define TL_WIRE_CASE_(code, NAME, text) case (code):",
         "#define TL_WIRE_CASE_(code, NAME, text)"),
)  # fmt: skip

# -- the real board's image, emulated ---------------------------------------------------------------------------------

_PORT = (
    _one("a crash coasts", EMULATED + "a_crash_of_the_processor_coasts_every_bridge_first",
         RP2040 + "main.c", "    bridge_coast_all();\n"),
    _one("an alarm that has passed is set again", IMAGE + "an alarm that passes while it is set", RP2040 + "main.c",
         "if ((int32_t)late_us < 0 || ", "if (true || "),
    _one("late steps keep the PWM's phase", IMAGE + "currents are sampled in the same phase after", RP2040 + "main.c",
         "(late_us / CONTROL_PERIOD_US + 1u) * CONTROL_PERIOD_US", "late_us + CONTROL_PERIOD_US"),
    _one("the PWM starts from RAM", IMAGE + "what has to be in time", RP2040 + "main.c",
         "static void __no_inline_not_in_flash_func(start_in_time)", "static void start_in_time"),
    _one("the PWM's phase", IMAGE + "currents are first sampled just before the end of a PWM period",
         RP2040 + "bridge.c", "(uint16_t)((2 * PERIOD - SENSE_BEFORE_END - ticks % PERIOD) % PERIOD)",
         "(uint16_t)(ticks % PERIOD)"),
    _one("the most of four samples", IMAGE + "the most of four samples counts", RP2040 + "bridge.c",
         "most = sample > most ? sample : most;", "most = sample;"),
    _one("a halt is watched", EMULATED + "a_debugger_that_holds_the_core_leaves_no_motor_running", RP2040 + "main.c",
         ", TAUTLINE_HALT_KEEPS_DRIVING);", ", true);"),
    _one("a lock is taken from RAM", EMULATED + "no_command_keeps_the_control_step_out", RP2040 + "main.c",
         "static uint32_t __not_in_flash_func(port_lock)", "static uint32_t port_lock"),
    _one("a glitch is looked at again", IMAGE + "a glitch beside an edge is no lost edge",
         RP2040 + "quadrature.pio", ".define LOOKS 15", ".define LOOKS 0"),
    _one("pull-ups settle", IMAGE + "lines that rise slowly after the pull-ups went on are no edges",
         RP2040 + "quadrature.c", "    busy_wait_us_32(PULL_UP_US);\n", "    (void)PULL_UP_US;\n"),
    _one("a completed transfer is left", IMAGE + "an endpoint whose halt is cleared beside a packet that completes",
         RP2040 + "usb_halt.c", "if (!(usb_hw->buf_status & bit)) {", "if (true) {"),
    _one("what a halt ended goes on", IMAGE + "an endpoint whose halt is cleared beside a packet that completes",
         RP2040 + "usb_halt.c", "            if (dead) {", "            if (false && dead) {"),
    _one("the supply is measured", "tests/board/test_safety.py::test_driver_and_supply", RP2040 + "bridge.c",
         "const unsigned address = turn < 5 ? turn :", "const unsigned address = turn < 5 ? turn % 4 :",
         board="emulated"),
    _one("the loader watches a trial", UPDATED + "an_image_that_hangs_gives_way_to_the_old_one",
         RP2040 + "loader.c", "    if (choice.trial) {", "    if (false) {"),
    _one("erratum E5's work-round", BUILT + "an_image_of_fewer_axes_comes_up_on_an_early_chip",
         RP2040 + "CMakeLists.txt", "TAUTLINE_AXES LESS 4)", "TAUTLINE_AXES LESS 0)"),
)  # fmt: skip

# -- the host, and the desktop board ----------------------------------------------------------------------------------

_HOST = (
    _one("this machine alone", COMMISSION + "a_simulated_board_listens_on_this_machine_alone",
         "firmware/port/desktop/net.c", "htonl(INADDR_LOOPBACK)", "htonl(INADDR_ANY)"),
    _one("the user at the machine", PAGE + "the_udev_rule_lets_the_user_at_the_machine_in",
         "tools/70-tautline.rules", ', TAG+="uaccess"', ', MODE="0666"'),
    _one("headers for C++", C_FILES + "every_public_header_may_be_included_from_cpp",
         "firmware/estimator/include/tautline/tl_play.h", 'extern "C" {', ""),
    _one("every list of codes", C_FILES + "every_list_of_codes_refuses_to_compile_with_one_twice",
         "common/include/tautline/tl_wire.h", "TL_WIRE_IS_(EVENTS, event_code)\n"),
    _one("tables name their instrument", COMMANDS + "a_model_of_another_instrument_is_refused_unless_forced",
         HOST + "tables.py", 'instrument if instrument is not None else rig.actuator.instrument or ""',
         'instrument or ""'),
    _one("another instrument by --force alone", COMMANDS + "a_model_of_another_instrument_is_refused_unless_forced",
         HOST + "cli/flash.py", "any_instrument=force", "any_instrument=True"),
    _one("the rig of the board's instrument",
         COMMANDS + "a_live_calibration_is_of_the_instrument_that_the_board_is_for",
         HOST + "live/session.py", "if here and there and here != there:", "if False:"),
    _one("faults into simulated boards alone", COMMISSION + "faults_go_to_simulated_boards_alone",
         HOST + "cli/inject.py", "    if board is not None:", "    if False:"),
    _one("a fault is named", EVERY_POINT,
         HOST + "device/board.py", "has stopped: {wire.fault(status)}. Then", "has stopped. Then"),
    Guard("room for a reply", "tests/c/test_axis.c::test_telemetry_is_even_and_every_drop_is_counted",
          (("firmware/app/src/tl_outbox.c", "return put(outbox, FOR_REPLIES,", "return put(outbox, 0,"),
           ("firmware/app/src/tl_outbox.c", "return has_room(outbox, FOR_REPLIES,", "return has_room(outbox, 0,"))),
    _one("clear clears", COMMISSION + "clear_names_the_fault_and_its_remedy",
         HOST + "cli/clear.py", '        board.ask("clear_fault", axis=axis)', "        pass"),
    _one("stored when agreed to", COMMISSION + "commission_does_nothing_that_was_not_agreed_to",
         HOST + "live/commission.py", "    if not agree(question):", "    if not agree(question) and False:"),
    _one("tried gains are taken back", COMMISSION + "a_fault_while_commissioning_stores_nothing",
         HOST + "live/commission.py", '                board.ask("servo", **_servo_fields(commissioned.before))\n',
         "                pass\n"),
    _one("commissioning that stops half way", COMMISSION + "commission_does_nothing_that_was_not_agreed_to",
         HOST + "live/commission.py", "            _store(live, settings)\n", "            pass\n"),
    _one("homing ends with its program", COMMISSION + "ctrl_c_during_homing_leaves_the_motor_at_rest_and_no_position",
         HOST + "live/setup.py", "                self.release()\n", "                pass\n"),
)  # fmt: skip

GUARDS = (*_LIVED, *_APP, *_PORT, *_HOST)
