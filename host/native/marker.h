/* The outline of a blob of one colour, to a few hundredths of a pixel: the inner loop of the marker tracker.
 *
 * Membership of a pixel is weights . (B, G, R) + offset, 1 on the marker as its colour was picked and about 0 around
 * it. The blob is the largest connected region above `cut` near the expected place. From its middle, rays go out; on
 * each the edge is where membership passes from the blob's own level *there* to the level of what is around it *on that
 * ray*, so neither an uneven background nor light from one side pulls it. A Fourier outline of order 3 is fitted to the
 * edges without those that do not fit (glare on the rim), and the answer is that outline's centroid. Where that outline
 * is not the one that the frames before lead to expect, something may be in front: then the place is the mean over the
 * ways to explain the frame (partly.h), by their probabilities.
 */
#ifndef TAUTLINE_MARKER_H
#define TAUTLINE_MARKER_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum {
    MARKER_RAYS_MAX = 256,
    MARKER_SHAPE = 7, /* terms of an outline about its middle: radius, then cosine and sine of 2, 3 and 4 t */
    MARKER_FOUND = 0,
    MARKER_NONE,    /* nothing above `cut`, or too small, or no contrast */
    MARKER_CLIPPED, /* it goes on beyond the region: try a larger one; every field of the answer is rough */
    MARKER_CUT_OFF, /* it goes on beyond the picture: its middle cannot be told; every field of the answer is rough */
};

/* A BGR picture, 8 bits a channel; `stride` bytes from row to row. The region is [x0, x1) x [y0, y1), inside of it. */
typedef struct {
    const uint8_t *bgr;
    ptrdiff_t stride;
    int width, height;
    int x0, y0, x1, y1;
} marker_view_t;

/* A term of the outline as a plane over the picture: smooth along the marker's way, the same there and back. */
typedef struct {
    double value, by_u, by_v; /* px, and by which it rises a px of the marker's way */
    double covariance[3][3];  /* of these three */
} marker_term_t;

/* The noise of edges about a whole outline: as wide as it is, and how smoothly it goes round (lens, codec). */
typedef struct {
    double frames;           /* that it was learnt from, the prior counted as one */
    double all, step, large; /* px2: variance of an edge; half of that of the difference between neighbours; of a term
                                of low order, times the edges that tell it */
} marker_noise_t;

/* What the frames before say of the next one. */
typedef struct {
    marker_term_t shape[MARKER_SHAPE]; /* of the outline r(t) about its middle, where the marker was seen last */
    double stretched[MARKER_SHAPE];    /* px, sigma: by which motion may change them in this frame alone */
    double steady[MARKER_SHAPE];       /* share of the wandering that the prior allows a term, by how it came so far */
    marker_noise_t noise;
    double shaded; /* probability that the marker is lit from one side: its level is a plane */
    int seen;      /* it was, at: */
    double u, v;   /* px */
} marker_expected_t;

typedef struct {
    double u, v;             /* px, centroid of the outline; integers are the middles of pixels */
    double sigma;            /* px per coordinate, from the scatter of the edges and from what may be hidden */
    double diameter;         /* px, of the disc with the outline's area */
    double within;           /* membership of the blob, median of its core */
    double around;           /* membership around it, mean over the rays */
    double scatter;          /* px, rms of the kept edges about the outline */
    double kept;             /* share of the rays whose edge fitted */
    double colour[3];        /* mean B, G, R of its core, levels */
    double lit_u, lit_v;     /* px, of (u, v): what that light moved it by, by this frame alone */
    marker_expected_t after; /* what this frame and those before say of the next */
} marker_outline_t;

/* Bytes of scratch memory for a region of so many pixels. */
size_t marker_scratch_size(size_t pixels);

/* What is known of a marker that was not seen yet, of about `diameter` px: it is a disc or a ball. */
void marker_expect(double diameter, marker_expected_t *out);

/* weights[3] per level of B, G, R and weights[3 + 1] = offset. (u, v) expected place, diameter expected, px. Returns
 * one of MARKER_*. O(pixels of the region); about 70 us for a marker of 20 px, 1 to 7 ms where a part
 * of it is hidden. */
int marker_measure(const marker_view_t *view, const float weights[4], double cut, double u, double v, double diameter,
                   const marker_expected_t *before, void *scratch, marker_outline_t *out);

#ifdef __cplusplus
}
#endif
#endif
