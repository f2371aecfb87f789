// New firmware page by page: what tl_update.h says of a file, of what is erased for it and when it counts, over files
// of any images, sent in any order, onto flash that wears out.
#include "draws.h"
#include "silent_port.h"
#include "tautline/tl_update.h"
#include "words.h"

#include <string.h>
#include <unity.h>

#define LIVES 1500
#define ROOM  (3U * TL_BOOT_SECTOR)
#define MOST  (ROOM - TL_BOOT_IMAGE)
#define PAGE  TL_BOOT_PAGE

static uint8_t slots[TL_BOOT_SLOTS][ROOM];
static uint8_t key[32], free_slot;
static tl_port_update_t slot_port;
static tl_port_t port;
static tl_axis_t axes[TL_WIRE_AXES_MAX];
static tl_update_t update;
static const uint8_t built_in[3] = {3, 1, 4};
static uint32_t fed, worn, ended[2], operations;
static bool wears;

// -- a port -----------------------------------------------------------------------------------------------------------

static void read(void *context, uint8_t slot, uint32_t offset, uint8_t *out, size_t size) {
    (void)context;
    TEST_ASSERT_TRUE(slot < TL_BOOT_SLOTS && offset <= ROOM && size <= ROOM - offset);
    memcpy(out, slots[slot] + offset, size);
}

static void operate(void) { // what takes long
    TEST_ASSERT_TRUE_MESSAGE(fed > 0U, "the watchdog is fed before");
    fed = 0;
    operations++;
}

static bool erase(void *context, uint8_t slot, uint32_t offset) {
    (void)context;
    TEST_ASSERT_TRUE(slot == free_slot && offset % TL_BOOT_SECTOR == 0U && offset < ROOM);
    operate();
    const uint8_t stays = slots[slot][worn];
    memset(slots[slot] + offset, 0xFF, TL_BOOT_SECTOR);
    slots[slot][worn] = wears ? stays : slots[slot][worn];
    return true;
}

static bool program(void *context, uint8_t slot, uint32_t offset, const uint8_t *page) {
    (void)context;
    TEST_ASSERT_TRUE(slot < TL_BOOT_SLOTS && offset % PAGE == 0U && offset < ROOM);
    operate();
    for (uint32_t i = 0; i < PAGE; i++) {
        slots[slot][offset + i] &= wears && offset + i == worn ? 0xFFU : page[i];
    }
    return true;
}

static uint8_t sum_of(const uint8_t *bytes, size_t size) {
    uint8_t sum = 1;
    for (size_t i = 0; i < size; i++) {
        sum = (uint8_t)(sum * 3U + bytes[i]);
    }
    return sum;
}

static bool is_signed(void *context, const uint8_t *signature, const uint8_t *message, size_t size) {
    (void)context;
    operate();
    TEST_ASSERT_EQUAL(TL_WIRE_IMAGE_SIGNED, size);
    return signature[0] == sum_of(message, size) && signature[63] == key[31];
}

static void hash(void *context, uint8_t slot, uint32_t size, uint8_t *out) {
    (void)context;
    operate();
    for (uint8_t i = 0; i < 32U; i++) {
        out[i] = (uint8_t)(sum_of(slots[slot] + TL_BOOT_IMAGE, size) + i);
    }
}

static void trial_ends(void *context, bool confirmed) {
    (void)context;
    ended[confirmed ? 1 : 0]++;
}

static void feed(void *context) {
    (void)context;
    fed++;
}

static tl_us_t began_us;
static tl_us_t time_us(void *context) {
    (void)context;
    return began_us;
}

void setUp(void) {
    seed = 161803U;
}
void tearDown(void) {}

// -- what the header says ---------------------------------------------------------------------------------------------

static struct {
    bool coming, any, trial;
    uint32_t come, next, taken; // bytes of the file; where the next head is; of the image that is taken
    uint8_t refused, version[3], head[PAGE], hash[32];
    uint8_t slot[ROOM]; // the free one
} m;

static bool all_off(void) {
    for (uint32_t i = 0; i < port.axes; i++) {
        if (axes[i].mode != TL_WIRE_MODE_OFF) {
            return false;
        }
    }
    return true;
}

static uint8_t refuses(uint8_t why) {
    if (why != TL_WIRE_UPDATE_NONE) {
        m.coming = m.any = false;
        m.refused = why;
    }
    return why;
}

// Where the flash of a page stays as it is, it does not take this one.
static bool takes(uint32_t offset, const uint8_t *page) {
    const bool bad = wears && worn - offset < PAGE && m.slot[worn] != page[worn - offset];
    for (uint32_t i = 0; i < PAGE; i++) {
        m.slot[offset + i] &= wears && offset + i == worn ? 0xFFU : page[i];
    }
    return !bad;
}

static void is_erased(uint32_t offset) {
    const uint8_t stays = m.slot[worn];
    memset(m.slot + offset, 0xFF, TL_BOOT_SECTOR);
    m.slot[worn] = wears ? stays : m.slot[worn];
}

static uint8_t may_write(void) {
    if (port.update == NULL) {
        return TL_WIRE_UPDATE_NO_SLOT;
    }
    return m.trial ? TL_WIRE_UPDATE_TRIAL : (all_off() ? TL_WIRE_UPDATE_NONE : TL_WIRE_UPDATE_NOT_OFF);
}

static bool is_older(const uint8_t *version) {
    const int32_t its = version[0] << 16 | version[1] << 8 | version[2];
    return its < (m.version[0] << 16 | m.version[1] << 8 | m.version[2]);
}

// A head: `sound` unless the page is none, its signature `good`. As the page is drawn at most one thing is wrong.
static uint8_t takes_head(const uint8_t *page, const tl_wire_image_t *head, bool sound, bool for_us, bool good) {
    if (!sound) {
        return TL_WIRE_UPDATE_DAMAGED;
    }
    if (!for_us) {
        return TL_WIRE_UPDATE_PORT;
    }
    m.next = m.come + PAGE + head->size;
    if (m.taken != 0U || (head->slot != free_slot && head->slot != 0xFFU)) {
        return TL_WIRE_UPDATE_NONE;
    }
    if (head->size > MOST) {
        return TL_WIRE_UPDATE_SIZE;
    }
    if (!m.any && is_older(head->version)) {
        return TL_WIRE_UPDATE_OLDER;
    }
    if (!good) {
        return TL_WIRE_UPDATE_SIGNATURE;
    }
    is_erased(0);
    m.taken = head->size;
    memcpy(m.head, page, PAGE);
    memcpy(m.hash, head->hash, sizeof(m.hash));
    return TL_WIRE_UPDATE_NONE;
}

static uint32_t taken_from; // of the file, where the bytes of the image that is taken begin

static uint8_t takes_page(const uint8_t *page) {
    if (m.taken == 0U || m.come - taken_from >= m.taken) {
        return TL_WIRE_UPDATE_NONE; // one that is passed over
    }
    const uint32_t offset = TL_BOOT_IMAGE + m.come - taken_from;
    if (offset % TL_BOOT_SECTOR == 0U) {
        is_erased(offset);
    }
    return takes(offset, page) ? TL_WIRE_UPDATE_NONE : TL_WIRE_UPDATE_FLASH;
}

static uint8_t ends(void) {
    uint8_t why = may_write(), is[32];
    if (why != TL_WIRE_UPDATE_NONE) {
        return why;
    }
    if (!m.coming || m.come != m.next) {
        return TL_WIRE_UPDATE_DAMAGED;
    }
    if (m.taken == 0U) {
        return TL_WIRE_UPDATE_LINKED;
    }
    for (uint8_t i = 0; i < 32U; i++) {
        is[i] = (uint8_t)(sum_of(m.slot + TL_BOOT_IMAGE, m.taken) + i);
    }
    if (memcmp(is, m.hash, sizeof(is)) != 0) {
        return TL_WIRE_UPDATE_HASH;
    }
    const uint32_t sequence = slot_port.slot == TL_BOOT_NONE ? 1U : word(slots[slot_port.slot], 1) + 1U;
    uint8_t record[PAGE];
    memset(record, 0xFF, sizeof(record));
    memcpy(record, "BOOT", 4);
    set_word(record, 1, sequence);
    set_word(record, 2, m.taken);
    set_word(record, 3, crc_of(m.slot + TL_BOOT_IMAGE, m.taken));
    set_word(record, 4, crc_of(record, 16));
    return takes(TL_BOOT_HEAD, m.head) && takes(TL_BOOT_RECORD, record) ? TL_WIRE_UPDATE_NONE : TL_WIRE_UPDATE_FLASH;
}

// -- files ------------------------------------------------------------------------------------------------------------

typedef struct {
    tl_wire_image_t head;
    uint8_t page[PAGE];
    bool sound, for_us, good;
} image_t;

static void sign(image_t *image) {
    uint8_t frame[PAGE];
    tl_wire_frame(frame, TL_WIRE_IMAGE, 0, &image->head);
    image->head.signature[0] = sum_of(frame + TL_WIRE_HEADER_SIZE, TL_WIRE_IMAGE_SIGNED);
    image->head.signature[63] = key[31];
}

static void any_port(tl_wire_image_t *head, bool *for_us) {
    char name[20] = {0};
    const uint8_t of = once_in(8) ? (uint8_t)between(1, 4) : port.axes;
    const size_t length = strlen(port.name);
    memcpy(name, port.name, length);
    if (of < TL_WIRE_AXES_MAX) {
        name[length] = '-';
        name[length + 1U] = (char)('0' + of);
    }
    *for_us = of == port.axes && strlen(name) <= sizeof(head->port);
    if (once_in(10)) {
        const size_t at = strlen(name) - (size_t)between(0, 1);
        name[at] = name[at] == '\0' ? 'x' : '\0'; // longer or shorter by one
        *for_us = at >= sizeof(head->port) && *for_us;
    }
    memcpy(head->port, name, sizeof(head->port));
}

static void any_image(image_t *image) {
    const uint32_t pages = once_in(3) ? (uint32_t)between(1, 3) : (uint32_t)between(14, MOST / PAGE);
    tl_wire_image_t *head = &image->head;
    *head = (tl_wire_image_t){.format = 1, .slot = once_in(4) ? 0xFFU : (uint8_t)between(0, 1), .size = pages * PAGE};
    *image = (image_t){.head = *head, .sound = true, .good = true};
    for (int i = 0; i < 3; i++) {
        head->version[i] = (uint8_t)(m.version[i] + (once_in(4) ? between(-1, 1) : 0));
    }
    any_port(head, &image->for_us);
    const int32_t wrong = between(0, 19);
    head->size = wrong == 0 ? MOST + PAGE : (wrong == 1 ? (once_in(2) ? 0U : head->size + 1U) : head->size);
    head->format = wrong == 2 ? (uint8_t)(2 * between(0, 1)) : 1U;
    image->sound = wrong != 1 && wrong != 2;
    for (uint8_t i = 0; i < 32U; i++) { // of the pages that send() makes
        head->hash[i] = (uint8_t)random_u32();
    }
    sign(image);
    image->good = wrong != 3;
    head->signature[wrong == 3 ? (once_in(2) ? 0 : 63) : 5] ^= 1U;
    memset(image->page, 0, PAGE);
    tl_wire_frame(image->page, TL_WIRE_IMAGE, 9, head);
    if (wrong == 4) {
        image->page[between(0, (int32_t)TL_WIRE_SIZE_IMAGE + 11)] ^= (uint8_t)(1U << between(0, 7));
        image->sound = false;
    } else if (wrong == 5) {
        const tl_wire_ping_t ping = {.host_us = 1};
        tl_wire_frame(image->page, TL_WIRE_PING, 9, &ping);
        image->sound = false;
    }
}

static void any_page(uint8_t *page) {
    memset(page, (uint8_t)random_u32(), PAGE);
    page[between(0, PAGE - 1)] = (uint8_t)random_u32();
}

static void is_as_said(void) {
    tl_wire_firmware_t told;
    tl_update_tell(&update, &told);
    TEST_ASSERT_EQUAL(m.coming, tl_update_is_coming(&update));
    TEST_ASSERT_EQUAL_MEMORY(m.version, told.version, sizeof(m.version));
    if (port.update == NULL) {
        TEST_ASSERT_EQUAL(TL_WIRE_UPDATE_NO_SLOT, told.refused);
        TEST_ASSERT_EQUAL(TL_BOOT_NONE, told.slot);
        TEST_ASSERT_EQUAL(TL_WIRE_FIRMWARE_STATE_CONFIRMED, told.state);
        return;
    }
    TEST_ASSERT_EQUAL_MEMORY(m.slot, slots[free_slot], ROOM);
    TEST_ASSERT_EQUAL(m.refused, told.refused);
    TEST_ASSERT_EQUAL(slot_port.slot, told.slot);
    TEST_ASSERT_EQUAL(MOST, told.room);
    TEST_ASSERT_EQUAL_MEMORY(key, told.key, sizeof(key));
    TEST_ASSERT_EQUAL(m.trial ? TL_WIRE_FIRMWARE_STATE_TRIAL : TL_WIRE_FIRMWARE_STATE_CONFIRMED, told.state);
    const tl_boot_flash_t flash = {.read = read, .room = ROOM};
    const tl_boot_slot_t other = tl_boot_slot(&flash, free_slot);
    const uint8_t state = other.failed
                              ? TL_WIRE_FIRMWARE_STATE_FAILED
                              : (other.confirmed ? TL_WIRE_FIRMWARE_STATE_CONFIRMED : TL_WIRE_FIRMWARE_STATE_TRIAL);
    TEST_ASSERT_EQUAL(other.whole ? state : TL_WIRE_FIRMWARE_STATE_NONE, told.other_state);
}

static uint8_t other_version[3]; // of what was committed last

// One page as a host sends it; false: refused.
static bool send_page(uint32_t offset, const uint8_t *page, size_t size, const image_t *head) {
    if (offset == 0U) {
        m.coming = true;
        m.refused = TL_WIRE_UPDATE_NONE;
        m.come = m.next = m.taken = 0;
    }
    uint8_t why = may_write();
    if (why == TL_WIRE_UPDATE_NONE && (!m.coming || offset != m.come || size != PAGE)) {
        why = TL_WIRE_UPDATE_DAMAGED;
    }
    const uint32_t before = operations, taken = m.taken;
    if (why == TL_WIRE_UPDATE_NONE && m.come == m.next) {
        why = head != NULL ? takes_head(page, &head->head, head->sound, head->for_us, head->good)
                           : TL_WIRE_UPDATE_DAMAGED; // any bytes
        taken_from = m.taken != taken ? m.come + PAGE : taken_from;
    } else if (why == TL_WIRE_UPDATE_NONE) {
        why = takes_page(page);
    }
    m.come += PAGE;
    refuses(why);
    TEST_ASSERT_EQUAL(why, tl_update_data(&update, offset, page, size));
    if (why != TL_WIRE_UPDATE_NONE && why != TL_WIRE_UPDATE_FLASH && why != TL_WIRE_UPDATE_SIGNATURE) {
        TEST_ASSERT_EQUAL_MESSAGE(before, operations, "nothing is touched for what is refused");
    }
    return why == TL_WIRE_UPDATE_NONE;
}

static void end_file(const image_t *image) {
    const uint8_t why = ends();
    TEST_ASSERT_EQUAL(why, tl_update_end(&update));
    m.coming = m.any = false;
    m.refused = why;
    if (why == TL_WIRE_UPDATE_NONE) {
        tl_wire_firmware_t told;
        tl_update_tell(&update, &told);
        TEST_ASSERT_EQUAL(TL_WIRE_FIRMWARE_STATE_TRIAL, told.other_state);
        TEST_ASSERT_EQUAL_MEMORY(image->head.version, told.other_version, 3);
        memcpy(other_version, told.other_version, 3);
    }
}

// The pages of an image, of which the hash is known beforehand: they are drawn twice from the same seed.
static void give_hash(image_t *image) {
    static uint8_t bytes[MOST + PAGE];
    const uint32_t kept = seed;
    if (image->head.size <= MOST && image->sound && !once_in(8)) {
        seed = 99U + image->head.size;
        for (uint32_t at = 0; at < image->head.size; at += PAGE) {
            any_page(bytes + at);
        }
        seed = kept;
        const uint8_t wrong = image->head.signature[0];
        sign(image);
        const uint8_t right = image->head.signature[0];
        for (uint8_t i = 0; i < 32U; i++) {
            image->head.hash[i] = (uint8_t)(sum_of(bytes, image->head.size) + i);
        }
        sign(image);
        image->head.signature[0] = (uint8_t)(image->head.signature[0] ^ (wrong ^ right));
        image->head.signature[63] = (uint8_t)(key[31] ^ (image->good || wrong != right ? 0U : 1U));
        tl_wire_frame(image->page, TL_WIRE_IMAGE, 9, &image->head);
    }
}

static void sends(void) {
    static image_t images[3], took;
    uint8_t page[PAGE];
    const uint32_t count = (uint32_t)between(1, 3), trips = once_in(3) ? (uint32_t)between(1, 60) : 1000U;
    uint32_t at = 0;
    m.any = update.any = m.any || once_in(4);
    for (uint32_t i = 0; i < count; i++) {
        any_image(&images[i]);
        give_hash(&images[i]);
        const uint32_t taken = m.taken, size = images[i].head.size;
        if (!send_page(at, images[i].page, PAGE, &images[i])) {
            break;
        }
        if (m.taken != taken || m.taken == 0U || i == 0U) {
            took = images[i];
        }
        at += PAGE;
        const uint32_t kept = seed;
        seed = 99U + size;
        bool on = true;
        for (uint32_t of = 0; of < size && on; of += PAGE, at += PAGE) {
            any_page(page);
            if (at / PAGE == trips) { // something goes wrong on its way
                on = once_in(2) ? send_page(at + (once_in(2) ? PAGE : 0U - PAGE), page, PAGE, NULL)
                                : send_page(at, page, once_in(2) ? PAGE - 1U : PAGE + 1U, NULL);
            } else {
                on = send_page(at, page, PAGE, NULL);
            }
        }
        seed = kept;
        if (!on || once_in(6)) {
            break;
        }
    }
    is_as_said();
    if (once_in(10)) {
        axes[port.axes - 1U].mode = TL_WIRE_MODE_HOLD;
    } else if (once_in(10)) {
        tl_update_abort(&update);
        m.coming = false;
    }
    end_file(&took);
    is_as_said();
}

// -- lives ------------------------------------------------------------------------------------------------------------

static void begins(void) {
    static const char *const names[] = {"fake", "a-board-of-14-c", "fourteen-chars"};
    memset(&m, 0, sizeof(m));
    memset(axes, 0, sizeof(axes));
    memset(ended, 0, sizeof(ended));
    for (uint32_t i = 0; i < 32U; i++) {
        key[i] = (uint8_t)random_u32();
    }
    memset(slots, 0xFF, sizeof(slots));
    slot_port = (tl_port_update_t){.key = key,
                                   .room = ROOM,
                                   .slot = once_in(6) ? TL_BOOT_NONE : (uint8_t)between(0, 1),
                                   .trial = once_in(8),
                                   .failed = once_in(4),
                                   .read = read,
                                   .erase = erase,
                                   .program = program,
                                   .is_signed = is_signed,
                                   .hash = hash,
                                   .trial_ends = trial_ends};
    port = (tl_port_t){.name = names[between(0, 2)],
                       .axes = (uint8_t)between(1, 4),
                       .time_us = time_us,
                       .watchdog_feed = feed,
                       .update = once_in(20) ? NULL : &slot_port};
    free_slot = slot_port.slot == 0U ? 1U : 0U;
    memcpy(m.version, built_in, sizeof(built_in));
    if (slot_port.slot != TL_BOOT_NONE) { // what runs
        uint8_t *bytes = slots[slot_port.slot];
        tl_boot_make_record(bytes, once_in(2) ? 0xFFFFFFFFU : random_u32(), 77, crc_of(bytes + TL_BOOT_IMAGE, 77));
        if (once_in(2)) { // which says what it is
            tl_wire_image_t head = {.format = 1, .version = {3, (uint8_t)between(0, 2), 5}, .size = PAGE};
            tl_wire_frame(bytes + TL_BOOT_HEAD, TL_WIRE_IMAGE, 0, &head);
            memcpy(m.version, port.update != NULL ? head.version : built_in, sizeof(built_in));
        }
    }
    for (uint32_t i = 0; i < ROOM; i += 64U) { // what ran before
        slots[free_slot][i + (uint32_t)between(0, 63)] = (uint8_t)random_u32();
    }
    wears = once_in(4);
    worn = (uint32_t)between(0, once_in(2) ? 1100 : (int32_t)ROOM - 1);
    began_us = random_u32();
    memcpy(m.slot, slots[free_slot], ROOM);
    if (port.update != NULL && slot_port.failed) {
        uint8_t mark[PAGE];
        memset(mark, 0xFF, sizeof(mark));
        memset(mark, 0x5A, 16);
        (void)takes(TL_BOOT_FAILED, mark);
    }
    m.trial = port.update != NULL && slot_port.trial;
    tl_update_init(&update, &port, axes, built_in);
    is_as_said();
}

// On trial: a host's word and two seconds confirm it, a minute without gives it up, and neither with a motor on.
static void is_tried(void) {
    static const tl_us_t since_us[] = {1999999, 2000000, 59999999, 60000000};
    const bool heard = once_in(2), on = once_in(4);
    const tl_us_t since = since_us[between(0, 3)];
    update.heard = heard;
    axes[port.axes - 1U].mode = on ? TL_WIRE_MODE_HOLD : TL_WIRE_MODE_OFF;
    wears = wears && slot_port.slot < TL_BOOT_SLOTS && slots[slot_port.slot][worn] != 0x5AU;
    const bool torn = wears && worn - TL_BOOT_CONFIRMED < 16U;
    tl_update_task(&update, began_us + since);
    const bool confirms = m.trial && !on && heard && since >= 2000000U && !torn;
    TEST_ASSERT_EQUAL(confirms, ended[1]);
    TEST_ASSERT_EQUAL(m.trial && !on && !heard && since >= 60000000U, ended[0]);
    m.trial = m.trial && !confirms;
    TEST_ASSERT_EQUAL(m.trial, update.trial);
    if (confirms && slot_port.slot < TL_BOOT_SLOTS) {
        for (uint32_t i = 0; i < 16U; i++) {
            TEST_ASSERT_EQUAL_HEX8(0x5A, slots[slot_port.slot][TL_BOOT_CONFIRMED + i]);
        }
    }
}

static void test_firmware_through_files_of_any_kind(void) {
    uint32_t committed = 0;
    for (uint32_t life = 0; life < LIVES; life++) {
        begins();
        if (slot_port.slot == TL_BOOT_NONE) {
            slot_port.trial = m.trial = update.trial = false;
        }
        for (uint32_t file = 0; file < 3U; file++) {
            axes[port.axes - 1U].mode = once_in(12) ? TL_WIRE_MODE_HOLD : TL_WIRE_MODE_OFF;
            sends();
            committed += m.refused == TL_WIRE_UPDATE_NONE ? 1U : 0U;
        }
        is_tried();
    }
    TEST_ASSERT_TRUE(committed > LIVES / 4);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_firmware_through_files_of_any_kind);
    return UNITY_END();
}
