// The store byte for byte: what tl_store.h says of slots, their order, a write and a clear, over flash that has been
// through anything, wears out and loses its power.
#include "draws.h"
#include "slot_model.h"

#include <string.h>
#include <unity.h>

#define LIVES  150
#define STEPS  60
#define PLACES (2U * (TL_STORE_SETTINGS + 1U))
#define SECTOR TL_PORT_FLASH_SECTOR

static uint8_t flash[PLACES][SECTOR], was[PLACES][SECTOR];
static tl_port_t port;
static uint8_t blob[TL_TABLE_SIZE_MAX + 1U];

// What is done to flash, and what keeps it from being done.
static struct {
    uint32_t erased, programmed; // of the last call; the first and the last sector erased, and the last page
    uint32_t first, last, page;
    uint32_t left;                          // operations until the power goes
    uint32_t sector, worn, fed, fed_before; // a byte that stays as it is; feeds of the watchdog
} done;

static void read(void *context, uint32_t offset, uint8_t *out, size_t size) {
    (void)context;
    TEST_ASSERT_TRUE(offset / SECTOR < PLACES && offset % SECTOR + size <= SECTOR);
    memcpy(out, flash[offset / SECTOR] + offset % SECTOR, size);
}

static bool operate(void) {
    TEST_ASSERT_TRUE_MESSAGE(done.fed > done.fed_before, "the watchdog is fed before each operation");
    done.fed_before = done.fed;
    if (done.left > 0U) {
        done.left--;
    }
    return done.left > 0U;
}

static bool erase(void *context, uint32_t offset) {
    (void)context;
    TEST_ASSERT_TRUE(offset % SECTOR == 0U && offset / SECTOR < PLACES);
    const uint32_t place = offset / SECTOR;
    const uint8_t worn = flash[place][done.worn];
    done.first = done.erased == 0U ? place : done.first;
    done.last = place;
    done.erased++;
    if (!operate()) {
        return false;
    }
    memset(flash[place], 0xFF, SECTOR);
    flash[place][done.worn] = place == done.sector ? worn : 0xFFU;
    return true;
}

static bool program(void *context, uint32_t offset, const uint8_t *page) {
    (void)context;
    TEST_ASSERT_TRUE(offset % TL_PORT_FLASH_PAGE == 0U && offset / SECTOR == done.last);
    uint8_t *bytes = flash[offset / SECTOR] + offset % SECTOR;
    done.page = offset % SECTOR;
    done.programmed++;
    if (!operate()) {
        return false;
    }
    for (uint32_t i = 0; i < TL_PORT_FLASH_PAGE; i++) {
        bytes[i] &= offset / SECTOR == done.sector && offset % SECTOR + i == done.worn ? 0xFFU : page[i];
    }
    return true;
}

static void feed(void *context) {
    (void)context;
    done.fed++;
}

void setUp(void) {
    seed = 31415U;
    port = (tl_port_t){.flash_read = read, .flash_erase = erase, .flash_program = program, .watchdog_feed = feed};
}
void tearDown(void) {}

static tl_slot_t slot_of(uint32_t place) {
    return slot_in(flash[place], place * SECTOR);
}

// -- tests ------------------------------------------------------------------------------------------------------------

static void slots_are_as_flash_says(uint8_t axis) {
    const tl_slot_t slots[2] = {slot_of(2U * axis), slot_of(2U * axis + 1U)};
    tl_slot_t order[TL_STORE_SLOTS];
    for (uint8_t i = 0; i < 2U; i++) {
        const tl_slot_t got = tl_store_slot(&port, axis, i);
        TEST_ASSERT_TRUE(is_same(&slots[i], &got));
    }
    tl_store_order(&port, axis, order);
    const unsigned best = best_of(&slots[0], &slots[1]);
    const unsigned first = best < 2U ? best : (is_same(&slots[1], &order[0]) ? 1U : 0U);
    TEST_ASSERT_TRUE(is_same(&slots[first], &order[0]));
    TEST_ASSERT_TRUE(is_same(&slots[1U - first], &order[1]));
}

static void begin(uint8_t axis, bool sound) {
    memcpy(was, flash, sizeof(was));
    memset(&done, 0, sizeof(done));
    done.left = sound || !once_in(3) ? 1000U : (uint32_t)between(1, 14);
    done.sector = !sound && once_in(3) ? 2U * axis + (uint32_t)between(0, 1) : PLACES;
    done.worn = (uint32_t)between(0, once_in(2) ? 30 : (int32_t)SECTOR - 1);
}

// What the sector holds after a write: the header's page, the blob, and nothing else.
static void expect(uint8_t *bytes, uint32_t sequence, uint16_t size) {
    memset(bytes, 0xFF, SECTOR);
    memcpy(bytes, "SLOT", 4);
    set_word(bytes, 1, sequence);
    set_word(bytes, 2, size);
    set_word(bytes, 3, crc_of(blob, size));
    set_word(bytes, 4, crc_of(bytes, 16));
    memcpy(bytes + TL_PORT_FLASH_PAGE, blob, size);
}

static void writes(uint8_t axis) {
    static uint8_t expected[SECTOR];
    static const uint16_t sizes[] = {0, 1, 63, 64, 65, 255, 256, 257, TL_TABLE_SIZE_MAX, TL_TABLE_SIZE_MAX + 1U};
    const uint16_t size = once_in(2) ? sizes[between(0, 9)] : (uint16_t)between(0, 700);
    const tl_slot_t a = slot_of(2U * axis), b = slot_of(2U * axis + 1U);
    const unsigned best = best_of(&a, &b), stays = once_in(2) ? (unsigned)between(0, 1) : 2U;
    const uint32_t kept = stays == 2U ? 0U : (2U * axis + stays) * SECTOR + TL_PORT_FLASH_PAGE;
    for (uint32_t i = 0; i < size; i++) {
        blob[i] = once_in(20) ? 0xFFU : (uint8_t)random_u32();
    }
    begin(axis, false);
    const uint32_t power = done.left, pages = (size + TL_PORT_FLASH_PAGE - 1U) / TL_PORT_FLASH_PAGE;
    const bool written = tl_store_write(&port, axis, kept, blob, size);
    if (size > TL_TABLE_SIZE_MAX) {
        TEST_ASSERT_FALSE(written);
        TEST_ASSERT_EQUAL(0, done.erased);
        return;
    }
    TEST_ASSERT_EQUAL(1, done.erased);
    const uint32_t target = done.last, other = target ^ 1U;
    TEST_ASSERT_EQUAL(axis, target / 2U);
    if (stays != 2U || best != 2U) {
        TEST_ASSERT_EQUAL(2U * axis + (stays != 2U ? stays : best), other);
    }
    const tl_slot_t *before = other % 2U == 0U ? &a : &b;
    expect(expected, before->whole ? before->sequence + 1U : 1U, size);
    const bool fits = done.sector != target || (was[target][done.worn] == 0xFFU && expected[done.worn] == 0xFFU);
    const bool never = done.sector == target && was[target][done.worn] != 0xFFU; // it is not even blank
    TEST_ASSERT_EQUAL(fits && power > 1U + pages + 1U, written);
    for (uint32_t place = 0; place < PLACES; place++) {
        if (place != target) {
            TEST_ASSERT_EQUAL_MEMORY(was[place], flash[place], SECTOR);
        }
    }
    if (written) {
        TEST_ASSERT_EQUAL_MEMORY(expected, flash[target], SECTOR);
        TEST_ASSERT_EQUAL(pages + 1U, done.programmed);
        TEST_ASSERT_EQUAL_MESSAGE(0, done.page, "the header last");
    } else if (never) {
        TEST_ASSERT_EQUAL_MESSAGE(0, done.programmed, "onto what is not blank");
    }
}

static void clears(uint8_t axis) {
    const tl_slot_t a = slot_of(2U * axis), b = slot_of(2U * axis + 1U);
    const unsigned best = best_of(&a, &b);
    begin(axis, false);
    const uint32_t power = done.left;
    const bool cleared = tl_store_clear(&port, axis);
    const bool wears = done.sector < PLACES && was[done.sector][done.worn] != 0xFFU;
    TEST_ASSERT_EQUAL(!wears && power > 2U, cleared);
    if (best < 2U) {
        TEST_ASSERT_EQUAL_MESSAGE(2U * axis + 1U - best, done.first, "the older first");
    }
    if (cleared) {
        TEST_ASSERT_TRUE(is_blank(flash[2U * axis], 2U * SECTOR));
    } else if (done.erased == 1U) {
        TEST_ASSERT_EQUAL_MEMORY(was[done.first ^ 1U], flash[done.first ^ 1U], SECTOR);
    }
    for (uint32_t place = 0; place < PLACES; place++) {
        if (place / 2U != axis) {
            TEST_ASSERT_EQUAL_MEMORY(was[place], flash[place], SECTOR);
        }
    }
}

// Time passes: bits flip, headers say something else, and sequences are about to wrap.
static void ages(uint8_t axis) {
    uint8_t *bytes = flash[2U * axis + (uint32_t)between(0, 1)];
    switch (between(0, 4)) {
    case 0:
        bytes[between(0, 19)] ^= (uint8_t)(1U << between(0, 7));
        break;
    case 1:
        bytes[between(256, 500)] ^= (uint8_t)(1U << between(0, 7));
        break;
    case 2:
        memset(bytes, 0xFF, TL_PORT_FLASH_PAGE);
        bytes[between(0, 255)] = once_in(2) ? 0U : 0xFFU;
        break;
    default: { // as another write would have left it
        const uint32_t near = flash[2U * axis + (uint32_t)between(0, 1)][4];
        static const uint32_t sizes[] = {TL_TABLE_SIZE_MAX, TL_TABLE_SIZE_MAX + 1U, 1, 0x10040U};
        memcpy(bytes, "SLOT", 4);
        set_word(bytes, 1, (once_in(2) ? near : 0xFFFFFFFFU) + (uint32_t)between(-2, 2));
        set_word(bytes, 2, once_in(2) ? sizes[between(0, 3)] : (uint32_t)between(0, 700));
        const uint32_t size = word(bytes, 2);
        set_word(bytes, 3, size > TL_TABLE_SIZE_MAX || once_in(8) ? 7U : crc_of(bytes + TL_PORT_FLASH_PAGE, size));
        set_word(bytes, 4, crc_of(bytes, 16));
        break;
    }
    }
}

static void test_the_store_through_its_lives(void) {
    for (uint32_t life = 0; life < LIVES; life++) {
        const uint8_t axis = (uint8_t)between(0, (int32_t)TL_STORE_SETTINGS);
        memset(flash, 0xFF, sizeof(flash));
        for (uint32_t step = 0; step < STEPS; step++) {
            const int32_t what = between(0, 9);
            if (what < 5) {
                writes(axis);
            } else if (what < 6) {
                clears(axis);
            } else {
                ages(axis);
            }
            slots_are_as_flash_says(axis);
        }
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_the_store_through_its_lives);
    return UNITY_END();
}
