// The fault log fault by fault: what tl_fault_log.h says of what is noted, written when, and read back, through cuts of
// power and many starts.
#include "draws.h"
#include "tautline/tl_fault_log.h"

#include <string.h>
#include <unity.h>

#define LIVES   15
#define STEPS   2000
#define AXES    3U
#define PAGE    TL_PORT_FLASH_PAGE
#define PAGES   (TL_PORT_FLASH_LOG / PAGE)
#define SECTOR  16U // pages
#define PENDING 8U

static uint8_t flash[PAGES][PAGE];
static tl_axis_t axes[AXES];
static tl_fault_log_t log_of;
static uint32_t erased, programmed, fed, cut, kept_out; // cut: the operation in which the power goes
static bool dead;

// -- a port -----------------------------------------------------------------------------------------------------------

static void flash_read(void *context, uint32_t offset, uint8_t *out, size_t size) {
    (void)context;
    const uint32_t at = offset - TL_PORT_FLASH_REGION;
    TEST_ASSERT_TRUE(offset >= TL_PORT_FLASH_REGION && at % PAGE + size <= PAGE && at / PAGE < PAGES);
    memcpy(out, flash[at / PAGE] + at % PAGE, size);
}

static bool operate(void) {
    TEST_ASSERT_EQUAL(0, kept_out);
    dead = dead || (cut > 0U && --cut == 0U);
    return !dead;
}

static bool flash_erase(void *context, uint32_t offset) {
    (void)context;
    const uint32_t page = (offset - TL_PORT_FLASH_REGION) / PAGE;
    TEST_ASSERT_TRUE(offset >= TL_PORT_FLASH_REGION && offset % TL_PORT_FLASH_SECTOR == 0U && page < PAGES);
    TEST_ASSERT_TRUE_MESSAGE(fed > 0U, "the watchdog is fed before");
    fed = 0;
    erased++;
    const bool whole = operate();
    memset(flash[page], 0xFF, (whole ? SECTOR : SECTOR / 2U) * PAGE);
    return whole;
}

static bool flash_program(void *context, uint32_t offset, const uint8_t *bytes) {
    (void)context;
    const uint32_t page = (offset - TL_PORT_FLASH_REGION) / PAGE;
    TEST_ASSERT_TRUE(offset % PAGE == 0U && page < PAGES);
    programmed++;
    const bool whole = operate();
    for (uint32_t i = 0; i < (whole ? PAGE : 9U); i++) {
        flash[page][i] &= bytes[i];
    }
    return whole;
}

static void feed(void *context) {
    (void)context;
    fed++;
}

static uint32_t lock(void *context) {
    (void)context;
    return kept_out++ + 7U;
}

static void unlock(void *context, uint32_t state) {
    (void)context;
    TEST_ASSERT_EQUAL(7, state);
    kept_out--;
}

static tl_port_t port = {.axes = AXES,
                         .keeps_log = true,
                         .flash_read = flash_read,
                         .flash_erase = flash_erase,
                         .flash_program = flash_program,
                         .watchdog_feed = feed,
                         .lock = lock,
                         .unlock = unlock};

void setUp(void) {
    seed = 1202056U;
}
void tearDown(void) {}

// -- what the header says ---------------------------------------------------------------------------------------------

typedef struct {
    enum { BLANK, TORN, THERE } is;
    tl_wire_logged_t what;
} page_t;

static struct {
    page_t page[PAGES];
    tl_wire_logged_t pending[PENDING];
    uint32_t waiting, number, run, next;
    bool seen[AXES], wrote;
    tl_us_t seen_us[AXES], wrote_us;
} m;

static void starts(void) {
    memset(m.pending, 0, sizeof(m.pending));
    memset(m.seen, 0, sizeof(m.seen));
    m.waiting = m.number = m.next = 0;
    m.wrote = dead = false;
    m.run = 1;
    for (uint32_t i = 0; i < PAGES; i++) {
        if (m.page[i].is == THERE && m.page[i].what.number > m.number) {
            m.number = m.page[i].what.number;
            m.run = m.page[i].what.run + 1U;
            m.next = (i + 1U) % PAGES;
        }
    }
    tl_fault_log_init(&log_of, &port, axes);
}

static void notes(void) {
    for (uint8_t i = 0; i < AXES; i++) {
        const tl_axis_t *axis = &axes[i];
        const bool faulted = axis->fault != TL_WIRE_FAULT_NONE;
        if (faulted && (!m.seen[i] || m.seen_us[i] != axis->guard.fault_us) && m.waiting < PENDING) {
            m.pending[m.waiting] = (tl_wire_logged_t){.number = m.number + m.waiting + 1U,
                                                      .run = m.run,
                                                      .axis = i,
                                                      .fault = axis->fault,
                                                      .value = axis->guard.fault_value,
                                                      .t_us = axis->guard.fault_us,
                                                      .q_q8 = axis->q};
            m.waiting++;
        }
        m.seen[i] = faulted;
        m.seen_us[i] = axis->guard.fault_us;
    }
}

// The oldest that waits, into the next page that is blank; at a sector's beginning this one is erased.
static void writes(tl_us_t now_us) {
    while (m.next % SECTOR != 0U && m.page[m.next].is != BLANK) {
        m.next = (m.next + 1U) % PAGES;
    }
    const uint32_t before = erased;
    const bool erases = m.next % SECTOR == 0U, torn = cut == 1U; // the power goes in the first operation
    for (uint32_t i = 0; erases && i < (torn ? SECTOR / 2U : SECTOR); i++) {
        m.page[m.next + i].is = BLANK;
    }
    if (!(erases && torn)) {
        m.page[m.next] = (page_t){cut == (erases ? 2U : 1U) ? TORN : THERE, m.pending[0]};
    }
    tl_fault_log_task(&log_of, now_us, true);
    TEST_ASSERT_EQUAL(erases ? before + 1U : before, erased);
    m.number = m.pending[0].number;
    m.next = (m.next + 1U) % PAGES;
    m.waiting--;
    memmove(m.pending, m.pending + 1, sizeof(m.pending) - sizeof(m.pending[0]));
    m.wrote = true;
    m.wrote_us = now_us;
}

static bool all_off(void) {
    bool off = true;
    for (uint32_t i = 0; i < AXES; i++) {
        off = off && axes[i].mode == TL_WIRE_MODE_OFF;
    }
    return off;
}

static void is_same(const tl_wire_logged_t *expected, const tl_wire_logged_t *got) {
    TEST_ASSERT_EQUAL(expected->number, got->number);
    TEST_ASSERT_EQUAL(expected->run, got->run);
    TEST_ASSERT_EQUAL(expected->axis, got->axis);
    TEST_ASSERT_EQUAL(expected->fault, got->fault);
    TEST_ASSERT_EQUAL(expected->value, got->value);
    TEST_ASSERT_TRUE(expected->t_us == got->t_us);
    TEST_ASSERT_EQUAL(expected->q_q8, got->q_q8);
}

// All that there are, the newest first, and then none.
static void reads(void) {
    tl_wire_logged_t got;
    uint32_t index = 0;
    for (uint32_t i = m.waiting; i > 0U; i--) {
        tl_fault_log_read(&log_of, (uint8_t)index++, &got);
        is_same(&m.pending[i - 1U], &got);
    }
    for (uint32_t number = m.number; number > 0U; number--) {
        uint32_t at = 0;
        while (at < PAGES && (m.page[at].is != THERE || m.page[at].what.number != number)) {
            at++;
        }
        if (at == PAGES) {
            break;
        }
        tl_fault_log_read(&log_of, (uint8_t)index++, &got);
        is_same(&m.page[at].what, &got);
        TEST_ASSERT_EQUAL(m.run, got.run_now);
    }
    const tl_wire_logged_t none = {.number = 0};
    for (uint32_t i = 0; i < 3U; i++) {
        tl_fault_log_read(&log_of, (uint8_t)(index + i), &got);
        is_same(&none, &got);
        TEST_ASSERT_EQUAL(m.run, got.run_now);
    }
}

static void happens(tl_us_t now_us) {
    tl_axis_t *axis = &axes[between(0, (int32_t)AXES - 1)];
    switch (between(0, 5)) {
    case 0:
        axis->fault = TL_WIRE_FAULT_NONE;
        break;
    case 1:
        axis->mode = once_in(3) ? TL_WIRE_MODE_HOLD : TL_WIRE_MODE_OFF;
        break;
    case 2: // one after the other, cleared within a millisecond
        axis->guard.fault_us = now_us - 1U;
        break;
    default:
        axis->fault = (uint8_t)between(1, 20);
        axis->guard.fault_value = any(31);
        axis->guard.fault_us = now_us;
        break;
    }
    axis->q = any(31);
}

static void test_the_log_through_many_starts(void) {
    uint32_t starts_of = 0, cuts = 0;
    for (uint32_t life = 0; life < LIVES; life++) {
        tl_us_t now_us = 1;
        memset(&m, 0, sizeof(m));
        memset(axes, 0, sizeof(axes));
        memset(flash, 0xFF, sizeof(flash));
        for (uint32_t i = 0; i < AXES; i++) {
            axes[i].port = &port;
        }
        cut = 0;
        starts();
        for (uint32_t step = 0; step < STEPS; step++) {
            now_us += (tl_us_t)(once_in(2) ? between(1, 3000) : (once_in(2) ? 400000 : 999999));
            if (once_in(3)) {
                happens(now_us);
            }
            if (once_in(12)) { // all is well for a while
                for (uint32_t i = 0; i < AXES; i++) {
                    axes[i].mode = TL_WIRE_MODE_OFF;
                }
            }
            const bool may_write = !once_in(8);
            cut = once_in(60) ? (uint32_t)between(1, 2) : 0U;
            notes();
            const uint32_t before = programmed + erased;
            if (m.waiting > 0U && may_write && all_off() && (!m.wrote || now_us - m.wrote_us >= 1000000U)) {
                writes(now_us);
            } else {
                tl_fault_log_task(&log_of, now_us, may_write);
                TEST_ASSERT_EQUAL(before, programmed + erased);
            }
            TEST_ASSERT_EQUAL(0, kept_out);
            cuts += dead;
            if (dead || once_in(300)) {
                starts();
                starts_of++;
                now_us = 1;
                reads();
            }
            if (once_in(15)) {
                reads();
            }
        }
    }
    TEST_ASSERT_TRUE(cuts > LIVES && starts_of > cuts);
}

static void test_a_port_without_a_log_has_none(void) {
    tl_wire_logged_t got;
    port.keeps_log = false;
    memset(flash, 0, sizeof(flash));
    tl_fault_log_init(&log_of, &port, axes);
    axes[0].fault = TL_WIRE_FAULT_STALL;
    const uint32_t before = programmed + erased;
    tl_fault_log_task(&log_of, 5, true);
    tl_fault_log_read(&log_of, 0, &got);
    TEST_ASSERT_EQUAL(0, got.number);
    TEST_ASSERT_EQUAL(before, programmed + erased);
    port.keeps_log = true;
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_the_log_through_many_starts);
    RUN_TEST(test_a_port_without_a_log_has_none);
    return UNITY_END();
}
