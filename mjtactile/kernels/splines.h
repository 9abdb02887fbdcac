/* Clamped cubic B-splines on even intervals, as core/bspline.py's Cubic: those that vanish at both ends. */
#ifndef MJTACTILE_SPLINES_H
#define MJTACTILE_SPLINES_H

typedef struct { long first; double value[4], slope[4]; } Local; /* the four from `first` on; all others are zero */

#define FEWEST_SPANS 3 /* four splines do not vanish in an interval */

Local splines_at(double length, long spans, double x); /* x from -length / 2 to length / 2, cut to that */

#endif
