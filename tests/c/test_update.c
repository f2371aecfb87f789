#include "fake_board.h"

#include <monocypher.h>

#include "tautline/tl_crc.h"
#include "tautline/tl_trust.h"

enum { ROOM = 6 * 4096, PAGES = 35, IMAGE = PAGES * 256, FILE_SIZE = 2 * (256 + IMAGE), RUNNING_SLOT = 0 };

static uint8_t slots[TL_BOOT_SLOTS][ROOM];
static uint8_t secret[64], key[32];
static uint8_t old_image[IMAGE], new_image[IMAGE];
static uint8_t file[FILE_SIZE];
static int trial_ended; // 1 confirmed, 2 given up
static tl_port_update_t update;

// -- a board with two slots, and its loader -----------------------------------------------------------------------

static void slot_read(void *context, uint8_t slot, uint32_t offset, uint8_t *out, size_t size) {
    (void)context;
    TEST_ASSERT_TRUE(slot < TL_BOOT_SLOTS && offset <= ROOM && size <= ROOM - offset);
    memcpy(out, slots[slot] + offset, size);
}

static bool slot_erase(void *context, uint8_t slot, uint32_t offset) {
    fake_t *f = context;
    TEST_ASSERT_TRUE_MESSAGE(slot != update.slot, "what runs is never erased");
    TEST_ASSERT_TRUE(offset % TL_PORT_FLASH_SECTOR == 0 && offset < ROOM);
    const bool before = f->dead;
    const bool whole = fake_operate(f);
    for (uint32_t i = 0; i < TL_PORT_FLASH_SECTOR && !before && !f->keeps; i++) {
        if (whole || fake_reached(f, i, TL_PORT_FLASH_SECTOR)) {
            slots[slot][offset + i] = 0xFF;
        }
    }
    return whole;
}

static bool slot_program(void *context, uint8_t slot, uint32_t offset, const uint8_t *page) {
    fake_t *f = context;
    TEST_ASSERT_TRUE(offset % TL_PORT_FLASH_PAGE == 0 && offset < ROOM);
    for (uint8_t i = 0; i < TL_WIRE_AXES_MAX; i++) {
        TEST_ASSERT_EQUAL_MESSAGE(0, f->duty[i], "flash is written with every motor off");
    }
    const bool before = f->dead;
    const bool whole = fake_operate(f);
    for (uint32_t i = 0; i < TL_PORT_FLASH_PAGE && !before; i++) {
        if (whole || fake_reached(f, i, TL_PORT_FLASH_PAGE)) {
            slots[slot][offset + i] &= f->sticks && i == 10U ? 0xFFU : page[i];
        }
    }
    return whole;
}

static bool slot_signed(void *context, const uint8_t *signature, const uint8_t *message, size_t size) {
    (void)context;
    return tl_trust_is_signed(key, signature, message, size);
}

static void slot_hash(void *context, uint8_t slot, uint32_t size, uint8_t *out) {
    (void)context;
    tl_trust_hash(&fake_port, slot, size, out);
}

static void slot_trial_ends(void *context, bool confirmed) {
    (void)context;
    trial_ended = confirmed ? 1 : 2;
}

static const tl_boot_flash_t flash = {.read = slot_read, .room = ROOM};

// The loader, then the application. `bitten`: by the watchdog, which keeps what the loader noted of a trial.
static void start(bool bitten) {
    const uint8_t failed = bitten && update.trial ? update.slot : TL_BOOT_NONE;
    const tl_boot_choice_t choice = tl_boot_choose(&flash, failed);
    update.slot = choice.slot;
    update.trial = choice.trial;
    update.failed = failed != TL_BOOT_NONE;
    trial_ended = 0;
    fake.t_us = 0;
    fake_start(1, bitten ? TL_WIRE_BOOT_WATCHDOG : TL_WIRE_BOOT_POWER);
}

// A watchdog bites in a trial, and where the pattern is one of the four the power goes while the application that runs
// then marks the other slot.
static void bite(unsigned pattern) {
    const uint8_t hung = update.slot;
    TEST_ASSERT_TRUE(update.trial);
    update.slot = tl_boot_choose(&flash, hung).slot;
    update.trial = false;
    update.failed = true;
    fake.operations = 0;
    fake.cut_at = pattern < 4U ? 1U : 0U;
    fake.cut_pattern = pattern;
    tl_app_init(&app, &fake_port);
    tl_app_bus(&app, true);
}

// Its image in a slot, confirmed, as it comes from a factory.
static void install(uint8_t slot, const uint8_t *image, uint32_t sequence) {
    memset(slots[slot], 0xFF, ROOM);
    memcpy(slots[slot] + TL_BOOT_IMAGE, image, IMAGE);
    tl_boot_make_record(slots[slot] + TL_BOOT_RECORD, sequence, IMAGE, tl_crc32(0, image, IMAGE));
    tl_boot_make_mark(slots[slot] + TL_BOOT_CONFIRMED);
}

static void make_head(uint8_t *page, uint8_t slot, const uint8_t *image, uint8_t major, const char *port) {
    tl_wire_image_t head = {.format = 1, .slot = slot, .version = {major, 2, 3}, .size = IMAGE};
    memcpy(head.port, port, strlen(port));
    crypto_blake2b(head.hash, sizeof(head.hash), image, IMAGE);
    memset(page, 0, 256);
    tl_wire_frame(page, TL_WIRE_IMAGE, 0, &head);
    crypto_eddsa_sign(head.signature, secret, page + TL_WIRE_HEADER_SIZE, TL_WIRE_IMAGE_SIGNED);
    tl_wire_frame(page, TL_WIRE_IMAGE, 0, &head);
}

static void make_file(uint8_t major) {
    for (uint8_t slot = 0; slot < 2; slot++) {
        uint8_t *page = file + slot * (256U + IMAGE);
        make_head(page, slot, new_image, major, "fake-1");
        memcpy(page + 256, new_image, IMAGE);
    }
}

static uint8_t send(const uint8_t *bytes, uint32_t size) {
    for (uint32_t at = 0; at < size; at += 256U) {
        const uint8_t why = tl_app_update_data(&app, at, bytes + at, size - at < 256U ? size - at : 256U);
        if (why != TL_WIRE_UPDATE_NONE) {
            return why;
        }
    }
    return tl_app_update_end(&app);
}

static void say_hello(void) {
    const tl_wire_hello_t hello = {.protocol_major = TL_WIRE_MAJOR};
    fake_ask(TL_WIRE_HELLO, &hello);
}

static tl_wire_firmware_t told(void) {
    const tl_wire_get_firmware_t request = {0};
    fake_ask(TL_WIRE_GET_FIRMWARE, &request);
    TEST_ASSERT_EQUAL(1, heard_count[TL_WIRE_FIRMWARE]);
    return heard[TL_WIRE_FIRMWARE].firmware;
}

static bool runs(const uint8_t *image) {
    return update.slot < TL_BOOT_SLOTS && memcmp(slots[update.slot] + TL_BOOT_IMAGE, image, IMAGE) == 0;
}

// A board that runs the old image out of slot 0; the other one is blank, or holds what ran before.
static void begin(bool used) {
    memset(slots, 0xFF, sizeof(slots));
    install(RUNNING_SLOT, old_image, 7);
    if (used) {
        install(1, new_image, 6);
        slots[1][TL_BOOT_IMAGE] ^= 0xFFU; // another one
        tl_boot_make_record(slots[1], 6, IMAGE, tl_crc32(0, slots[1] + TL_BOOT_IMAGE, IMAGE));
    }
    update.trial = update.failed = false;
    update.slot = TL_BOOT_NONE;
    fake_new(1);
    start(false);
    TEST_ASSERT_TRUE(runs(old_image));
}

void setUp(void) {
    uint8_t seed[32] = {1, 2, 3};
    crypto_eddsa_key_pair(secret, key, seed);
    update = (tl_port_update_t){.key = key,
                                .room = ROOM,
                                .slot = TL_BOOT_NONE,
                                .read = slot_read,
                                .erase = slot_erase,
                                .program = slot_program,
                                .is_signed = slot_signed,
                                .hash = slot_hash,
                                .trial_ends = slot_trial_ends};
    fake_update = &update;
    for (uint32_t i = 0; i < IMAGE; i++) {
        old_image[i] = (uint8_t)(i * 2654435761U >> 13);
        new_image[i] = (uint8_t)(i * 2246822519U >> 11);
    }
    make_file(1);
    begin(false);
}
void tearDown(void) {}

// -- tests ----------------------------------------------------------------------------------------------------------

static void test_new_firmware_runs_from_the_next_start_on_and_is_confirmed_by_a_host(void) {
    TEST_ASSERT_EQUAL(TL_WIRE_UPDATE_NONE, send(file, FILE_SIZE));
    TEST_ASSERT_EQUAL(TL_WIRE_FIRMWARE_STATE_CONFIRMED, told().state);
    TEST_ASSERT_EQUAL(0, told().slot);
    TEST_ASSERT_EQUAL(TL_WIRE_FIRMWARE_STATE_TRIAL, told().other_state);
    TEST_ASSERT_EQUAL(1, told().other_version[0]);
    start(false);
    TEST_ASSERT_TRUE(runs(new_image));
    TEST_ASSERT_EQUAL(TL_WIRE_FIRMWARE_STATE_TRIAL, told().state);
    TEST_ASSERT_EQUAL(1, told().version[0]);
    fake_run_ms(5000); // without a host it is not confirmed, however long it runs
    TEST_ASSERT_EQUAL(0, trial_ended);
    start(false);
    say_hello();
    fake_run_ms(1900);
    TEST_ASSERT_EQUAL(0, trial_ended);
    fake_run_ms(200);
    TEST_ASSERT_EQUAL(1, trial_ended);
    TEST_ASSERT_EQUAL(TL_WIRE_FIRMWARE_STATE_CONFIRMED, told().state);
    update.trial = false; // as the port clears it
    start(true);
    TEST_ASSERT_TRUE(runs(new_image)); // a later hang is no trial
    TEST_ASSERT_EQUAL(TL_WIRE_FIRMWARE_STATE_CONFIRMED, told().state);
    TEST_ASSERT_EQUAL(TL_WIRE_UPDATE_NONE, send(file, FILE_SIZE)); // and the next one goes to slot 0
    start(false);
    TEST_ASSERT_EQUAL(0, update.slot);
    TEST_ASSERT_TRUE(runs(new_image));
}

// The power goes in each operation, in four ways, with the free slot blank or used; where an image is lost, both are.
static void test_a_power_cut_at_any_operation_of_an_update_leaves_one_that_runs(void) {
    unsigned old_ones = 0, new_ones = 0;
    for (unsigned used = 0; used < 2; used++) {
        for (unsigned pattern = 0; pattern < 4; pattern++) {
            for (uint32_t cut = 1;; cut++) {
                begin(used != 0);
                fake.cut_at = cut;
                fake.cut_pattern = pattern;
                const uint8_t why = send(file, FILE_SIZE);
                if (!fake.dead) {
                    TEST_ASSERT_EQUAL(TL_WIRE_UPDATE_NONE, why);
                    TEST_ASSERT_EQUAL(1 + 3 + PAGES + 2 + 1, cut); // sectors, pages, head and record were each cut
                    break;
                }
                TEST_ASSERT_EQUAL(TL_WIRE_UPDATE_FLASH, why);
                start(false);
                TEST_ASSERT_TRUE(runs(old_image) || runs(new_image));
                old_ones += runs(old_image);
                new_ones += runs(new_image);
                if (!update.trial) { // and again, cut once more, in another way
                    fake.cut_at = cut * 7U % 41U + 1U;
                    fake.cut_pattern = (pattern + cut) % 4U;
                    send(file, FILE_SIZE);
                    start(false);
                    TEST_ASSERT_TRUE(runs(old_image) || runs(new_image));
                }
                if (!update.trial) {
                    TEST_ASSERT_EQUAL(TL_WIRE_UPDATE_NONE, send(file, FILE_SIZE));
                    start(false);
                }
                TEST_ASSERT_TRUE(runs(new_image));
            }
        }
    }
    TEST_ASSERT_TRUE(old_ones > 300 && new_ones > 0);
}

static void test_a_power_cut_while_confirming_loses_neither(void) {
    for (unsigned pattern = 0; pattern < 4; pattern++) {
        begin(false);
        send(file, FILE_SIZE);
        start(false);
        fake.cut_at = 1;
        fake.cut_pattern = pattern;
        say_hello();
        fake_run_ms(2100);
        TEST_ASSERT_TRUE(fake.dead);
        TEST_ASSERT_EQUAL(0, trial_ended);
        start(false);
        TEST_ASSERT_TRUE(runs(new_image));
        say_hello();
        fake_run_ms(2100);
        update.trial = false;
        start(false);
        TEST_ASSERT_TRUE(runs(new_image));
        TEST_ASSERT_FALSE(update.trial);
    }
}

static void test_new_firmware_that_hangs_gives_way_to_the_old_one_for_good(void) {
    unsigned torn = 0;
    for (unsigned pattern = 0; pattern < 5; pattern++) { // the last: no cut
        begin(true);
        send(file, FILE_SIZE);
        start(false);
        TEST_ASSERT_TRUE(update.trial && runs(new_image));
        start(false); // a cut of power says nothing against it
        TEST_ASSERT_TRUE(update.trial && runs(new_image));
        bite(pattern);
        TEST_ASSERT_TRUE(runs(old_image));
        if (fake.dead) { // its mark may be torn: then it is tried once more, and given up again
            start(false);
            TEST_ASSERT_TRUE(update.trial ? runs(new_image) : runs(old_image));
            torn += update.trial;
            start(update.trial);
            TEST_ASSERT_TRUE(runs(old_image));
        }
        TEST_ASSERT_EQUAL(TL_WIRE_FIRMWARE_STATE_FAILED, told().other_state);
        start(false);
        TEST_ASSERT_TRUE(runs(old_image) && !update.trial);
        TEST_ASSERT_EQUAL(TL_WIRE_UPDATE_NONE, send(file, FILE_SIZE)); // the next attempt is a new one
        start(false);
        TEST_ASSERT_TRUE(update.trial && runs(new_image));
    }
    TEST_ASSERT_TRUE(torn > 1);
}

static void test_new_firmware_that_no_host_has_talked_to_is_given_up(void) {
    send(file, FILE_SIZE);
    start(false);
    fake_run_ms(59900);
    TEST_ASSERT_EQUAL(0, trial_ended);
    fake_run_ms(200);
    TEST_ASSERT_EQUAL(2, trial_ended);
    start(true);
    TEST_ASSERT_TRUE(runs(old_image));
    TEST_ASSERT_EQUAL(TL_WIRE_FIRMWARE_STATE_FAILED, told().other_state);
}

static void test_nothing_is_erased_for_a_file_that_is_refused(void) {
    static uint8_t bad[FILE_SIZE];
    const struct {
        uint8_t why;
        uint8_t major;
        const char *port;
        uint32_t flipped; // byte of the head of slot 1's image
    } cases[] = {
        {TL_WIRE_UPDATE_OLDER, 0, "fake-1", 0},   {TL_WIRE_UPDATE_PORT, 1, "fak", 0},
        {TL_WIRE_UPDATE_PORT, 1, "fake", 0},      {TL_WIRE_UPDATE_PORT, 1, "fake-2", 0},
        {TL_WIRE_UPDATE_PORT, 1, "fake-11", 0},   {TL_WIRE_UPDATE_PORT, 1, "fake-1-of-a-page", 0},
        {TL_WIRE_UPDATE_DAMAGED, 1, "fake-1", 9},
    };
    begin(true);
    memcpy(app.update.version, (uint8_t[]){1, 0, 0}, 3); // what runs
    for (unsigned i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
        memcpy(bad, file, FILE_SIZE);
        make_head(bad + 256 + IMAGE, 1, new_image, cases[i].major, cases[i].port);
        if (cases[i].flipped != 0) {
            bad[256 + IMAGE + cases[i].flipped] ^= 1U;
        }
        TEST_ASSERT_EQUAL(cases[i].why, send(bad, FILE_SIZE));
        TEST_ASSERT_EQUAL(cases[i].why, told().refused);
    }
    // Signed with another key: every byte of it is as it should be.
    uint8_t seed[32] = {9}, other[32];
    memcpy(bad, file, FILE_SIZE);
    crypto_eddsa_key_pair(secret, other, seed);
    make_head(bad + 256 + IMAGE, 1, new_image, 1, "fake-1");
    TEST_ASSERT_EQUAL(TL_WIRE_UPDATE_SIGNATURE, send(bad, FILE_SIZE));
    // The image for slot 0 alone; a head alone, of another size; out of order; not whole pages.
    TEST_ASSERT_EQUAL(TL_WIRE_UPDATE_LINKED, send(file, 256 + IMAGE));
    TEST_ASSERT_EQUAL(TL_WIRE_UPDATE_DAMAGED, tl_app_update_data(&app, 256, file, 256));
    TEST_ASSERT_EQUAL(TL_WIRE_UPDATE_DAMAGED, send(file, 200));
    TEST_ASSERT_EQUAL(TL_WIRE_UPDATE_DAMAGED, tl_app_update_end(&app));
    TEST_ASSERT_EQUAL(0, fake.operations);
    // With a motor on, or on trial.
    fake_ready();
    TEST_ASSERT_EQUAL(0, fake_enable(0, 1));
    TEST_ASSERT_EQUAL(TL_WIRE_UPDATE_NOT_OFF, send(file, FILE_SIZE));
    TEST_ASSERT_EQUAL(0, fake.operations);
    TEST_ASSERT_TRUE(tl_boot_slot(&flash, 1).whole);
}

// An image for three would leave the fourth motor alone. With all four the name is the port's alone, as it was before
// there was a number.
static void test_firmware_for_another_number_of_axes_is_refused(void) {
    for (uint8_t axes = 1; axes <= TL_WIRE_AXES_MAX; axes++) {
        for (uint8_t of = 1; of <= TL_WIRE_AXES_MAX; of++) {
            char name[16];
            (void)snprintf(name, sizeof(name), of < 4 ? "fake-%u" : "fake", of);
            begin(true);
            fake_start(axes, TL_WIRE_BOOT_POWER);
            memcpy(app.update.version, (uint8_t[]){1, 0, 0}, 3);
            const uint32_t before = fake.operations;
            make_head(file, 0, new_image, 1, name);
            make_head(file + 256 + IMAGE, 1, new_image, 1, name);
            TEST_ASSERT_EQUAL(of == axes ? TL_WIRE_UPDATE_NONE : TL_WIRE_UPDATE_PORT, send(file, FILE_SIZE));
            TEST_ASSERT_EQUAL(of == axes, fake.operations != before);
        }
    }
}

static void test_an_older_one_comes_where_it_is_asked_for(void) {
    app.update.version[0] = 2;
    TEST_ASSERT_EQUAL(TL_WIRE_UPDATE_OLDER, send(file, FILE_SIZE));
    tl_wire_any_firmware_t any = {.key = 1};
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_KEY, fake_ask(TL_WIRE_ANY_FIRMWARE, &any));
    any.key = TL_WIRE_KEY;
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_ANY_FIRMWARE, &any));
    TEST_ASSERT_EQUAL(TL_WIRE_UPDATE_NONE, send(file, FILE_SIZE));
    TEST_ASSERT_EQUAL(TL_WIRE_UPDATE_OLDER, send(file, FILE_SIZE)); // once
}

static void test_a_file_that_ends_early_or_changed_on_its_way_does_not_count(void) {
    TEST_ASSERT_EQUAL(TL_WIRE_UPDATE_DAMAGED, send(file, FILE_SIZE - 256));
    start(false);
    TEST_ASSERT_TRUE(runs(old_image));
    file[2 * 256 + IMAGE + 300] ^= 1U; // in the image that the board takes
    TEST_ASSERT_EQUAL(TL_WIRE_UPDATE_HASH, send(file, FILE_SIZE));
    start(false);
    TEST_ASSERT_TRUE(runs(old_image));
}

static void test_on_trial_the_old_one_is_not_overwritten(void) {
    send(file, FILE_SIZE);
    start(false);
    TEST_ASSERT_EQUAL(TL_WIRE_UPDATE_TRIAL, send(file, FILE_SIZE));
    TEST_ASSERT_TRUE(tl_boot_slot(&flash, 0).whole);
}

static void test_what_flash_did_not_take_does_not_count(void) {
    fake.sticks = true;
    TEST_ASSERT_EQUAL(TL_WIRE_UPDATE_FLASH, send(file, FILE_SIZE));
    fake.sticks = false;
    begin(true);
    fake.keeps = true;
    TEST_ASSERT_EQUAL(TL_WIRE_UPDATE_FLASH, send(file, FILE_SIZE));
    start(false);
    TEST_ASSERT_TRUE(runs(old_image));
}

static void test_a_flipped_bit_falls_back_to_the_other_slot(void) {
    send(file, FILE_SIZE);
    for (uint32_t bit = 0; bit < 8U * (TL_BOOT_IMAGE + IMAGE); bit += 997U) {
        const uint32_t byte = bit / 8U;
        slots[1][byte] ^= (uint8_t)(1U << (bit % 8U));
        const bool matters = byte < 20U || byte >= TL_BOOT_IMAGE;
        TEST_ASSERT_EQUAL(matters ? 0 : 1, tl_boot_choose(&flash, TL_BOOT_NONE).slot);
        slots[1][byte] ^= (uint8_t)(1U << (bit % 8U));
    }
    slots[0][TL_BOOT_IMAGE] ^= 1U;
    slots[1][TL_BOOT_IMAGE] ^= 1U;
    TEST_ASSERT_EQUAL(TL_BOOT_NONE, tl_boot_choose(&flash, TL_BOOT_NONE).slot);
}

static void test_sequence_numbers_of_slots_may_wrap(void) {
    install(0, old_image, 0xFFFFFFFFU);
    start(false);
    TEST_ASSERT_EQUAL(TL_WIRE_UPDATE_NONE, send(file, FILE_SIZE));
    start(false);
    TEST_ASSERT_TRUE(runs(new_image));
}

static void test_a_board_without_slots_says_so(void) {
    fake_update = NULL;
    fake_start(1, TL_WIRE_BOOT_POWER);
    TEST_ASSERT_EQUAL(TL_WIRE_UPDATE_NO_SLOT, send(file, FILE_SIZE));
    TEST_ASSERT_EQUAL(TL_WIRE_UPDATE_NO_SLOT, told().refused);
    TEST_ASSERT_EQUAL(TL_BOOT_NONE, told().slot);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_new_firmware_runs_from_the_next_start_on_and_is_confirmed_by_a_host);
    RUN_TEST(test_a_power_cut_at_any_operation_of_an_update_leaves_one_that_runs);
    RUN_TEST(test_a_power_cut_while_confirming_loses_neither);
    RUN_TEST(test_new_firmware_that_hangs_gives_way_to_the_old_one_for_good);
    RUN_TEST(test_new_firmware_that_no_host_has_talked_to_is_given_up);
    RUN_TEST(test_nothing_is_erased_for_a_file_that_is_refused);
    RUN_TEST(test_firmware_for_another_number_of_axes_is_refused);
    RUN_TEST(test_an_older_one_comes_where_it_is_asked_for);
    RUN_TEST(test_a_file_that_ends_early_or_changed_on_its_way_does_not_count);
    RUN_TEST(test_on_trial_the_old_one_is_not_overwritten);
    RUN_TEST(test_what_flash_did_not_take_does_not_count);
    RUN_TEST(test_a_flipped_bit_falls_back_to_the_other_slot);
    RUN_TEST(test_sequence_numbers_of_slots_may_wrap);
    RUN_TEST(test_a_board_without_slots_says_so);
    return UNITY_END();
}
