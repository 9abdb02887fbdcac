/* Clamped cubic B-splines on even intervals, as Cubic in core/bspline.py: those that vanish at both
   ends. */
#ifndef MJTACTILE_SPLINES_H
#define MJTACTILE_SPLINES_H

/* the four from `first` on; all others are zero */
typedef struct { long first; double value[4], slope[4]; } Local;

#define FEWEST_SPANS 3 /* four splines do not vanish in an interval */

/* x from -length / 2 to length / 2, clipped to it */
Local splines_at(double length, long spans, double x);

#endif
