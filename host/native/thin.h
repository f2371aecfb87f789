// Which samples of a motion straight lines need.
#ifndef TAUTLINE_THIN_H
#define TAUTLINE_THIN_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { THIN_CHANNELS = 12 };

// Which samples of `channels` (1 to THIN_CHANNELS, one after the other, each as long as t_s) to keep so that straight
// lines between them stay within `tolerance[channel]` of all samples. Both ends and the ends of every rest (no channel
// changes for longer than rest_s) are kept. keep[k] is 0 or 1. About 10 ns per value.
void thin_motion(const double *t_s, size_t samples, const double *values, const double *tolerance, size_t channels,
                 double rest_s, unsigned char *keep);

#ifdef __cplusplus
}
#endif
#endif
