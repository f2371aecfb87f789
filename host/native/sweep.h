#ifndef TAUTLINE_SWEEP_H
#define TAUTLINE_SWEEP_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { SWEEP_ORDER = 3 }; // at most

// A path on nodes, and what its readings say of it. Unit of position: an encoder's count where `half` is 0.5, any where
// it is 0: readings are not rounded. Unit of time: any.
typedef struct {
    size_t nodes;
    size_t order;          // 2: its speed is constant but for rare changes; 3: its acceleration
    const double *change;  // (nodes - order, order + 1) factors of the positions of nodes i to i + order in a change
    const double *reading; // (nodes)
    const unsigned char *read; // (nodes) 0 where a node has no reading
    double half;               // a reading is at most so far from path and noise
    double noise;              // standard deviation of white noise on readings; on return as estimated, if any is read
    double jump;               // square of the Cauchy scale of a change (of order `order`) in a unit of time
    double *state;             // (nodes) positions
    double *precision, *force; // (nodes) of each reading's Gaussian: what it says of the path
    double *jumped;            // (nodes - order) mean squares of the changes; below 0: not known yet
    double *variance;          // (nodes) of the positions
    double told;               // on return: log probability of each reading, left out, by all others; their sum
} sweep_t;

enum { SWEEP_WORK = SWEEP_ORDER + 2 }; // a node

// Once through: the Gaussian path (state, variance) by what readings and changes were said to be, then each of those
// by the path. Changes are Student-t of one degree as Gaussians of unknown variance (a variational bound), the
// readings are matched in their moments (expectation propagation). work: (nodes + SWEEP_ORDER) * SWEEP_WORK.
// Returns 0 where the numbers do not hold: then nothing of it is to be used.
int sweep(sweep_t *path, double *work);

#ifdef __cplusplus
}
#endif

#endif
