"""Independent membrane for tests: triangles, neo-Hookean or StVK rubber, gas, surface loads; static
equilibrium by Newton's method. It shares no code with the package. Sensing writes the membrane as
B-splines in weak form, MuJoCo as a flex. This is a plain total-Lagrangian finite-element code, so
that agreement is meaningful.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla


class ReferenceMembrane:
    """Rectangle `length` x `width` m clamped on its rim; equi-biaxial pre-stretch; sealed gas
    behind it.

    `transmission` is "neo-Hookean", W = mu/2 (I1 - 3 - 2 ln J) + L/2 (ln J)^2 in plane stress, or "StVK".
    """

    def __init__(
        self,
        length,
        width,
        thickness,
        young,
        poisson,
        pre_stretch,
        chamber_volume,
        ambient,
        n=41,
        law="neo-Hookean",
    ):
        ny = round((n - 1) * width / length) + 1
        x = np.linspace(-length / 2, length / 2, n)
        y = np.linspace(-width / 2, width / 2, ny)
        gx, gy = np.meshgrid(x, y, indexing="ij")
        self.X = np.column_stack([gx.ravel(), gy.ravel()])
        index = np.arange(n * ny).reshape(n, ny)
        a = index[:-1, :-1]
        b = index[1:, :-1]
        c = index[1:, 1:]
        d = index[:-1, 1:]
        # alternate the diagonals: no preferred direction
        odd = (np.indices(a.shape).sum(0) % 2).astype(bool)
        one = np.where(odd[..., None], np.stack([a, b, d], -1), np.stack([a, b, c], -1))
        two = np.where(odd[..., None], np.stack([b, c, d], -1), np.stack([a, c, d], -1))
        self.tri = np.concatenate([one.reshape(-1, 3), two.reshape(-1, 3)])
        rim = np.ones((n, ny), bool)
        rim[1:-1, 1:-1] = False
        self.free = np.flatnonzero(~rim.ravel())
        self.shape = (n, ny)
        self.grid = (x, y)
        self.stretch = pre_stretch
        self.nu = poisson
        self.modulus = young * thickness / (1 - poisson**2)
        self.law = law
        self.mu = young * thickness / (2 * (1 + poisson))
        self.bulk = 2 * self.mu * poisson / (1 - 2 * poisson)  # Lame's L, in N/m
        self.chamber = chamber_volume
        self.ambient = ambient
        X = self.X[self.tri]
        D = np.stack([X[:, 1] - X[:, 0], X[:, 2] - X[:, 0]], -1)
        self.area0 = np.linalg.det(D) / 2
        shape_gradient = np.array([[-1.0, -1.0], [1, 0], [0, 1]])
        self.G = shape_gradient @ np.linalg.inv(D)  # (T, 3 nodes, 2)
        self.node_area = np.bincount(self.tri.ravel(), np.repeat(self.area0 / 3, 3), len(self.X))

    def _elastic(self, x):
        """Return nodal elastic forces (V, 3) (gradient of the energy) and element stiffness (T, 9,
        9)."""
        F = np.einsum("tni,tna->tia", x[self.tri], self.G)
        S, moduli = (self._neo_hookean if self.law == "neo-Hookean" else self._stvk)(
            self.stretch**2 * np.einsum("tia,tib->tab", F, F)
        )
        f = np.einsum("t,tia,tab,tnb->tni", self.area0, F, S, self.G)
        nodal = np.zeros_like(x)
        np.add.at(nodal, self.tri, f)
        geometric = np.einsum("t,tna,tab,tmb->tnm", self.area0, self.G, S, self.G)
        # dE/dx_(n,i) as a symmetric 2x2, then C : dE
        dE = np.einsum("tia,tnb->tniab", F, self.G)
        dE = self.stretch**2 * (dE + np.swapaxes(dE, -1, -2)) / 2
        CdE = np.einsum("tabcd,tnicd->tniab", moduli, dE)
        K = np.einsum("t,tniab,tmjab->tnimj", self.area0, dE, CdE) / self.stretch**2
        for i in range(3):
            K[:, :, i, :, i] += geometric
        return nodal, K.reshape(len(K), 9, 9)

    def _stvk(self, C):
        """Return stress (T, 2, 2) and its derivative by Green's strain (T, 2, 2, 2, 2), N/m, of
        Cauchy-Green tensors C."""
        E = (C - np.eye(2)) / 2
        one = np.eye(2)
        shear = np.einsum("ac,bd->abcd", one, one)
        volume = np.einsum("ab,cd->abcd", one, one)
        moduli = self.modulus * ((1 - self.nu) * shear + self.nu * volume)
        return np.einsum("abcd,tcd->tab", moduli, E), np.broadcast_to(moduli, (len(C), 2, 2, 2, 2))

    def _neo_hookean(self, C):
        """Return the same for W: S = 2 dW/dC at the thickness stretch c^(1/2) at which dW/dc = 0,
        found by bisection."""
        inverse = np.linalg.inv(C)
        det = np.linalg.det(C)
        low = np.full(len(C), 1e-3)
        high = np.full(len(C), 1e2)
        for _ in range(60):
            c = np.sqrt(low * high)
            thick = self.mu * (c - 1) + self.bulk / 2 * np.log(c * det) > 0
            low = np.where(thick, low, c)
            high = np.where(thick, c, high)
        # dS = mu (c C^-1 dC C^-1 - dc C^-1) with dC = 2 dE, and dc from the derivative of dW/dc = 0
        turned = np.einsum("tac,tdb->tabcd", inverse, inverse)
        moduli = self.mu * c[:, None, None, None, None] * (turned + np.swapaxes(turned, 3, 4))
        dc = self.bulk / (self.mu + self.bulk / (2 * c))
        moduli += (
            self.mu * dc[:, None, None, None, None] * np.einsum("tab,tcd->tabcd", inverse, inverse)
        )
        return self.mu * (np.eye(2) - c[:, None, None] * inverse), moduli

    def _volume(self, x):
        """Return bulge volume and its gradient (V, 3)."""
        a, b, c = (x[self.tri[:, k]] for k in range(3))
        volume = np.einsum("ti,ti->", a, np.cross(b, c)) / 6
        g = np.zeros_like(x)
        for k, v in enumerate((np.cross(b, c), np.cross(c, a), np.cross(a, b))):
            np.add.at(g, self.tri[:, k], v / 6)
        return volume, g

    def solve(self, load, *, gauge=None, sealed=None, x=None):
        """Return equilibrium positions (V, 3) under nodal loads (V, 3) N.

        `gauge` Pa: constant pressure; or `sealed` = p V of the gas, J (isothermal). Returns (x,
        gauge pressure).
        """
        x = np.column_stack([self.X, 1e-5 * np.ones(len(self.X))]) if x is None else x.copy()
        x[np.setdiff1d(np.arange(len(x)), self.free), 2] = 0
        dofs = (3 * self.free[:, None] + np.arange(3)).ravel()
        rows = (3 * self.tri[:, :, None] + np.arange(3)).reshape(len(self.tri), 9)
        I = np.repeat(rows, 9, axis=1).ravel()
        J = np.tile(rows, (1, 9)).ravel()
        for _ in range(200):
            nodal, K = self._elastic(x)
            volume, g = self._volume(x)
            p = gauge if sealed is None else sealed / (self.chamber + volume) - self.ambient
            residual = (nodal - p * g - load).ravel()[dofs]
            if np.abs(residual).max() < 1e-11:
                return x, p
            full = sp.csc_matrix((K.ravel(), (I, J)), shape=(3 * len(x),) * 2)[dofs][:, dofs]
            regular = full + 1e-6 * abs(full).max() * sp.identity(len(dofs))
            lu = spla.splu(sp.csc_matrix(regular))
            step = lu.solve(residual)
            if sealed is not None:  # rank-one gas stiffness k g g^T by Sherman-Morrison
                k = sealed / (self.chamber + volume) ** 2
                gf = g.ravel()[dofs]
                w = lu.solve(gf)
                step -= w * (k * (gf @ step)) / (1 + k * (gf @ w))
            scale = min(1.0, 5e-4 / max(np.abs(step).max(), 1e-30))
            x.reshape(-1)[dofs] -= scale * step
        raise RuntimeError("no equilibrium found")
