// Which image runs: what tl_boot.h says of records, marks and the choice, over slots in any state.
#include "draws.h"
#include "tautline/tl_boot.h"
#include "words.h"

#include <string.h>
#include <unity.h>

#define CASES 20000
#define ROOM  (TL_BOOT_IMAGE + 700U)

static uint8_t slots[TL_BOOT_SLOTS][ROOM];

static void read(void *context, uint8_t slot, uint32_t offset, uint8_t *out, size_t size) {
    TEST_ASSERT_EQUAL_PTR(slots, context);
    TEST_ASSERT_TRUE(slot < TL_BOOT_SLOTS && offset <= ROOM && size <= ROOM - offset);
    memcpy(out, slots[slot] + offset, size);
}

static const tl_boot_flash_t flash = {.read = read, .context = slots, .room = ROOM};

void setUp(void) {
    seed = 271828U;
}
void tearDown(void) {}

// -- what the header says ---------------------------------------------------------------------------------------------

static bool is_marked(const uint8_t *page) {
    for (unsigned i = 0; i < 16U; i++) {
        if (page[i] != 0x5AU) {
            return false;
        }
    }
    return true;
}

static tl_boot_slot_t slot_of(uint8_t slot) {
    const uint8_t *bytes = slots[slot];
    const uint32_t size = word(bytes, 2);
    const bool is_record = memcmp(bytes, "BOOT", 4) == 0 && word(bytes, 4) == crc_of(bytes, 16);
    if (!is_record || size == 0U || size > ROOM - TL_BOOT_IMAGE ||
        word(bytes, 3) != crc_of(bytes + TL_BOOT_IMAGE, size)) {
        return (tl_boot_slot_t){.whole = false};
    }
    return (tl_boot_slot_t){.whole = true,
                            .confirmed = is_marked(bytes + TL_BOOT_CONFIRMED),
                            .failed = is_marked(bytes + TL_BOOT_FAILED),
                            .sequence = word(bytes, 1),
                            .size = size};
}

// -- slots in any state -----------------------------------------------------------------------------------------------

static void any_mark(uint8_t *page) {
    tl_boot_make_mark(page);
    if (once_in(2)) { // none, or one that was torn
        memset(page, 0xFF, once_in(2) ? TL_BOOT_PAGE : (size_t)between(1, 16));
    } else if (once_in(8)) {
        page[between(0, 15)] = 0xFFU;
    }
}

static void any_slot(uint8_t *bytes, uint32_t near) {
    static const uint32_t sizes[] = {1, 63, 64, 65, 128, 699, 700};
    const uint32_t size = once_in(2) ? sizes[between(0, 6)] : (uint32_t)between(1, 300);
    for (uint32_t i = 0; i < 64U; i++) {
        bytes[TL_BOOT_IMAGE + (uint32_t)between(0, 699)] = (uint8_t)random_u32();
    }
    tl_boot_make_record(bytes, near, size, crc_of(bytes + TL_BOOT_IMAGE, size));
    any_mark(bytes + TL_BOOT_CONFIRMED);
    any_mark(bytes + TL_BOOT_FAILED);
    switch (between(0, 9)) {
    case 0:
        bytes[between(0, 19)] ^= (uint8_t)(1U << between(0, 7));
        break;
    case 1:
        bytes[TL_BOOT_IMAGE + (uint32_t)between(0, (int32_t)size - 1)] ^= (uint8_t)(1U << between(0, 7));
        break;
    case 2: // a record of an image that cannot be
        set_word(bytes, 2, once_in(2) ? 0U : ROOM - TL_BOOT_IMAGE + 1U);
        set_word(bytes, 3, once_in(2) ? 0U : crc_of(bytes + TL_BOOT_IMAGE, 1));
        set_word(bytes, 4, crc_of(bytes, 16));
        break;
    case 3:
        memset(bytes, 0xFF, TL_BOOT_IMAGE);
        break;
    default:
        break;
    }
}

static void test_the_newest_whole_image_that_has_not_failed_runs(void) {
    uint32_t chosen[3] = {0};
    memset(slots, 0xFF, sizeof(slots));
    for (uint32_t i = 0; i < CASES; i++) {
        const uint32_t near = once_in(2) ? 0xFFFFFFFFU : random_u32();
        const uint32_t ahead = once_in(2) ? (uint32_t)between(-2, 2) : 0x80000000U + (uint32_t)between(-1, 1);
        any_slot(slots[0], near);
        any_slot(slots[1], near + ahead);
        tl_boot_slot_t is[TL_BOOT_SLOTS];
        bool may[TL_BOOT_SLOTS];
        const uint8_t failed = once_in(2) ? TL_BOOT_NONE : (uint8_t)between(0, 1);
        for (uint8_t slot = 0; slot < TL_BOOT_SLOTS; slot++) {
            is[slot] = slot_of(slot);
            const tl_boot_slot_t got = tl_boot_slot(&flash, slot);
            TEST_ASSERT_EQUAL(is[slot].whole, got.whole);
            TEST_ASSERT_EQUAL(is[slot].confirmed, got.confirmed);
            TEST_ASSERT_EQUAL(is[slot].failed, got.failed);
            TEST_ASSERT_EQUAL_HEX32(is[slot].sequence, got.sequence);
            TEST_ASSERT_EQUAL(is[slot].size, got.size);
            may[slot] = is[slot].whole && !is[slot].failed && (slot != failed || is[slot].confirmed);
        }
        const uint32_t newer = is[1].sequence - is[0].sequence; // by less than half the range
        const bool tie = newer == 0U || newer == 0x80000000U;
        const tl_boot_choice_t choice = tl_boot_choose(&flash, failed);
        if (!may[0] && !may[1]) {
            TEST_ASSERT_EQUAL(TL_BOOT_NONE, choice.slot);
            TEST_ASSERT_FALSE(choice.trial);
        } else {
            TEST_ASSERT_TRUE(choice.slot < TL_BOOT_SLOTS && may[choice.slot]);
            if (may[0] && may[1] && !tie) {
                TEST_ASSERT_EQUAL(newer < 0x80000000U, choice.slot);
            }
            TEST_ASSERT_EQUAL(!is[choice.slot].confirmed, choice.trial);
        }
        chosen[choice.slot < TL_BOOT_SLOTS ? choice.slot : 2U]++;
    }
    TEST_ASSERT_TRUE(chosen[0] > CASES / 10 && chosen[1] > CASES / 10 && chosen[2] > CASES / 100);
}

static void test_pages_are_the_documented_ones(void) {
    uint8_t page[TL_BOOT_PAGE + 1U], expected[TL_BOOT_PAGE + 1U]; // and nothing behind them
    memset(page, 0, sizeof(page));
    memset(expected, 0xFF, TL_BOOT_PAGE);
    memset(expected, 0x5A, 16);
    expected[TL_BOOT_PAGE] = 0;
    tl_boot_make_mark(page);
    TEST_ASSERT_EQUAL_MEMORY(expected, page, sizeof(page));
    for (uint32_t i = 0; i < 200U; i++) {
        const uint32_t sequence = random_u32(), size = random_u32(), crc = random_u32();
        memset(expected, 0xFF, TL_BOOT_PAGE);
        memcpy(expected, "BOOT", 4);
        set_word(expected, 1, sequence);
        set_word(expected, 2, size);
        set_word(expected, 3, crc);
        set_word(expected, 4, crc_of(expected, 16));
        memset(page, 0, sizeof(page));
        tl_boot_make_record(page, sequence, size, crc);
        TEST_ASSERT_EQUAL_MEMORY(expected, page, sizeof(page));
    }
}

static void test_an_image_s_checksum_is_of_so_many_bytes(void) {
    for (uint32_t i = 0; i < 700U; i++) {
        slots[1][TL_BOOT_IMAGE + i] = (uint8_t)random_u32();
    }
    for (uint32_t size = 0; size <= 700U; size++) {
        TEST_ASSERT_EQUAL_HEX32(crc_of(slots[1] + TL_BOOT_IMAGE, size), tl_boot_crc(&flash, 1, size));
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_the_newest_whole_image_that_has_not_failed_runs);
    RUN_TEST(test_pages_are_the_documented_ones);
    RUN_TEST(test_an_image_s_checksum_is_of_so_many_bytes);
    return UNITY_END();
}
