"""Do two renderers estimate the same picture? A two-sample test on means of blocks of pixels.

Each side gives the block means of several independent seeds. A block's difference is measured in
its standard error (Welch's t); the smallest of all p-values is corrected for their number (Sidak)
and compared with ALPHA. The mean of the whole picture may be off by MEAN_Z standard errors.
tests/render/test_mitsuba.c does the same with the kept references.
"""
import math

import numpy as np

BLOCK = 8
ALPHA = 1e-6
MEAN_Z = 4.0
# Mitsuba calculates in single precision: differences below this share of a value say nothing.
SINGLE = 3e-5


def blocks_of(picture):
    """Means over BLOCK x BLOCK pixels: (rows, columns, 3). The sides are multiples of BLOCK."""
    h, w, c = picture.shape
    return picture.reshape(h // BLOCK, BLOCK, w // BLOCK, BLOCK, c).mean(axis=(1, 3))


def _beta_fraction(a, b, x):
    """Continued fraction of the incomplete beta function (Lentz; Abramowitz and Stegun 26.5.8)."""
    tiny = 1e-300
    c, d = 1.0, 1 - (a + b) * x / (a + 1)
    d = 1 / (d if abs(d) > tiny else tiny)
    result = d
    for m in range(1, 400):
        for numerator in (m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m)),
                          -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1))):
            d = 1 + numerator * d
            c = 1 + numerator / c
            d = 1 / (d if abs(d) > tiny else tiny)
            c = c if abs(c) > tiny else tiny
            result *= d * c
        if abs(d * c - 1) < 1e-12:
            break
    return result


def t_two_sided(t, dof):
    """P(|T| > |t|) for Student's t."""
    a, b, x = dof / 2, 0.5, dof / (dof + t * t)
    if x >= 1:
        return 1.0
    front = math.exp(math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b) + a * math.log(x) +
                     b * math.log1p(-x))
    if x < (a + 1) / (a + b + 2):
        return front * _beta_fraction(a, b, x) / a
    return 1 - front * _beta_fraction(b, a, 1 - x) / b


class Verdict:
    """p: Sidak-corrected p-value of the worst block; worst: its index (row, column, channel);
    t: its statistic; mean_z; ratio: of the means of the pictures; scatter: mean square of all t
    over what Student's t would give, about 1."""

    def __init__(self, ours, theirs):
        def summary(x):
            return x.mean(axis=0), x.var(axis=0, ddof=1) / len(x), len(x) - 1

        (m1, v1, n1), (m2, v2, n2) = summary(np.asarray(ours)), summary(np.asarray(theirs))
        floor = (SINGLE * np.maximum(np.abs(m1), np.abs(m2))) ** 2 + 1e-30
        error2 = v1 + v2 + floor
        t = (m1 - m2) / np.sqrt(error2)
        dof = error2 ** 2 / (v1 ** 2 / n1 + v2 ** 2 / n2 + floor ** 2 / (n1 + n2) + 1e-300)
        ps = np.array([t_two_sided(a, b) for a, b in zip(t.ravel(), dof.ravel())]).reshape(t.shape)
        self.worst = np.unravel_index(np.argmin(ps), t.shape)
        self.t = float(t[self.worst])
        self.p = float(-np.expm1(t.size * np.log1p(-min(ps.min(), 1 - 1e-16))))
        self.scatter = float((t ** 2).mean() / np.mean(dof / np.maximum(dof - 2, 0.5)))
        i1, w1, _ = summary(np.asarray(ours).reshape(len(ours), -1).mean(axis=1))
        i2, w2, _ = summary(np.asarray(theirs).reshape(len(theirs), -1).mean(axis=1))
        self.mean_z = float((i1 - i2) / math.sqrt(w1 + w2 + (SINGLE * max(i1, i2)) ** 2 + 1e-30))
        self.ratio = float(i1 / i2) if i2 else math.nan
        # What a difference of the picture's mean would have to be to be seen.
        self.mean_error = float(math.sqrt(w1 + w2) / i2) if i2 else math.nan

    def agrees(self):
        return self.p >= ALPHA and abs(self.mean_z) < MEAN_Z

    def __str__(self):
        return (f"{'agrees' if self.agrees() else 'DIFFERS'}: mean ratio {self.ratio:.5f} "
                f"(z {self.mean_z:+.2f}, +-{100 * self.mean_error:.3f} %), worst block "
                f"{tuple(int(i) for i in self.worst)} t {self.t:+.2f}, p {self.p:.2g}, "
                f"scatter {self.scatter:.2f}")
