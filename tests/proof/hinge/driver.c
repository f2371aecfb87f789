#include "__fc_builtin.h"

#include "../detectors.h"
#include "../reals.h"

#include "../../../firmware/estimator/src/tl_hinge.c"

static void sums(void) {
    tl_onset_sums_t line = any_sums();
    const tl_onset_sums_t level = any_sums(), all = any_sums();
    tl_hinge_meeting_t meeting;
    tl_hinge_t fit;
    gain_t best = {NUMBER(), NUMBER()};
    tl_hinge_meet(&line, &level, Frama_C_int_interval(0, 15), &meeting);
    tl_hinge_scatter(&line);
    tl_hinge_without(&line, &level);
    value_of(&best, &all);
    describe(&d, &line, &best, Frama_C_int_interval(0, 15), &fit);
    improves(&best, &line, &all);
    refine(&line, &all, Frama_C_int_interval(-(1 << 18), 0), Frama_C_int_interval(0, 1 << 18));
    line = any_sums();
    shift(&line, LONG(18));
}

static void points(void) {
    tl_onset_sums_t line = any_sums();
    const int32_t i = Frama_C_int_interval(0, TL_ONSET_WINDOW);
    const tl_count_q8_t origin = ANY();
    const tl_hinge_point_t point = tl_hinge_point(&d, i, origin, tl_hinge_scale(&d, i, origin));
    tl_hinge_add(&line, &point);
    tl_hinge_image(&d, i);
}

int main(void) {
    any_detector();
    sums();
    points();
    return 0;
}
