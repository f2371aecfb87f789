#include "thin.h"

#include <math.h>

void thin_motion(const double *t_s, size_t samples, const double *values, const double *tolerance, size_t channels,
                 double rest_s, unsigned char *keep) {
    for (size_t k = 0; k < samples; k++) {
        keep[k] = k == 0 || k + 1 == samples;
    }
    // The ends of rests.
    for (size_t k = 1, begin = 0; k <= samples; k++) {
        int same = k < samples;
        for (size_t c = 0; same && c < channels; c++) {
            same = values[c * samples + k] == values[c * samples + k - 1];
        }
        if (!same) {
            if (t_s[k - 1] - t_s[begin] > rest_s) {
                keep[begin] = keep[k - 1] = 1;
            }
            begin = k;
        }
    }
    // Slopes from `start` on that pass all samples since within tolerance: a sample whose own slope is outside ends the
    // piece at the one before.
    double low[THIN_CHANNELS], high[THIN_CHANNELS];
    size_t start = 0;
    for (size_t k = 1; k < samples; k++) {
        int fits = k > start + 1;
        for (size_t c = 0; fits && c < channels; c++) {
            const double *v = values + c * samples;
            const double slope = (v[k] - v[start]) / (t_s[k] - t_s[start]);
            fits = slope >= low[c] && slope <= high[c];
        }
        if (!fits && k > start + 1) {
            start = k - 1;
            keep[start] = 1;
        }
        const double dt = t_s[k] - t_s[start];
        for (size_t c = 0; c < channels; c++) {
            const double *v = values + c * samples;
            const double least = (v[k] - tolerance[c] - v[start]) / dt;
            const double most = (v[k] + tolerance[c] - v[start]) / dt;
            low[c] = k > start + 1 ? fmax(low[c], least) : least;
            high[c] = k > start + 1 ? fmin(high[c], most) : most;
        }
        if (keep[k]) {
            start = k;
        }
    }
}
