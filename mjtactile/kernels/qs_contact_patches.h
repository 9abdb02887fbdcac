/* Contact patches of a quasi-static membrane: one per MuJoCo body. */
#ifndef MJTACTILE_QS_CONTACT_PATCHES_H
#define MJTACTILE_QS_CONTACT_PATCHES_H
#include "qs_scene.h"
#include "qs_workspace.h"

/* End the contact of a patch. */
void qs_release(Patch *p);

/* Update the patches after a solution: their bodies, loads, centers and sticking stiffness. The
   latter is updated if enough nodes differ from those of `touched` (3, count): patches of the nodes
   at the last sticking stiffness and at the last solution, and workspace. `shift` (slots, 2), m: in-plane
   displacement of a patch's nodes since the last solution. Returns 1 if memory runs out. */
int qs_update_patches(const Membrane *f, const Bodies *bodies, const Scene *s, const ContactNodes *seen, long line, const Given *g,
                      const double *x, const double *force, const double *found, const double *compliance, double *x_before,
                      int32_t *touched, Memory *m, Patch *patches, double *grip, Held *held, double *shift);

/* Sum up the patches in the state of the membrane. */
void qs_sum_patches(const Membrane *f, const double *x, const double *force, const int32_t *was, long slots, const Patch *patches,
                        Memory *m);

#endif
