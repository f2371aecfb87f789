/* Rays from a blob's middle and the edges on them: what both descriptions of a marker's outline are fitted to. */
#ifndef TAUTLINE_RAYS_H
#define TAUTLINE_RAYS_H

#include <stdint.h>

#include "marker.h"

#define STEP 0.5 /* px between samples along a ray */
#define PI   3.14159265358979323846

enum {
    PLANE = 3, /* terms of a level: in the middle, slopes along x and y */
    TERMS = 7, /* of an outline about the blob's middle, up to order 3 */
    UNKNOWNS_MAX = MARKER_SHAPE + 2,
};

/* What a pixel of the region is: all but BELOW are above the cut. */
enum { BELOW, ABOVE, OTHER, BLOB };

/* The region's pixels: membership and what they are. */
typedef struct {
    const float *y;
    const uint8_t *mark;
    int columns, rows;
} field_t;

typedef struct {
    int count;
    double basis[MARKER_RAYS_MAX][TERMS]; /* 1, cos t, sin t, cos 2t, ... */
    double crossing[MARKER_RAYS_MAX], around[MARKER_RAYS_MAX], edge[MARKER_RAYS_MAX], fit[MARKER_RAYS_MAX];
    int keep[MARKER_RAYS_MAX];
} rays_t;

/* The k-th smallest of n, which are put into another order. */
float rays_kth(float *x, int n, int k);

/* Cholesky's factor of the leading n unknowns in place (the lower triangle), and b's solution. 0: singular, too few
 * rays are left. */
int rays_solve(double a[UNKNOWNS_MAX][UNKNOWNS_MAX], double b[UNKNOWNS_MAX], int n);

/* `count` samples along a ray, STEP apart from r on; held beyond the region's rim. */
void rays_sample(const field_t *field, double cx, double cy, const double *basis, double r, int count, float *out);

/* One ray for each pixel of a rim of `radius` px. */
void rays_aim(rays_t *rays, double radius);

/* The last pixel that is `least` or more on every ray within `reach` px, and the level of what is beyond it. Returns
 * the mean of the latter. */
double rays_look_beyond(rays_t *rays, const field_t *field, uint8_t least, double cx, double cy, double reach);

/* level: the marker's own in (cx, cy), and how it rises a px along x and y. keep: where it has a contrast. */
void rays_find_edges(rays_t *rays, const field_t *field, double cx, double cy, const double level[PLANE]);

#endif
