/* Moeller-Trumbore under the name MOLLER_TRUMBORE, for figure_methods.c and figure_fma.c: the same
 * words, compiled in two ways. Included by these two only. */
bool MOLLER_TRUMBORE(const struct figure_triangle *f, const double org[3], const double dir[3],
                     double epsilon, double *t)
{
    double e1[3], e2[3], s[3], p[3], q[3], det = 0, u = 0, v = 0, along = 0;
    for (int k = 0; k < 3; k++) {
        e1[k] = f->v[1][k] - f->v[0][k];
        e2[k] = f->v[2][k] - f->v[0][k];
        s[k] = org[k] - f->v[0][k];
    }
    for (int k = 0; k < 3; k++) {
        int x = (k + 1) % 3, y = (k + 2) % 3;
        p[k] = dir[x] * e2[y] - dir[y] * e2[x];
        q[k] = s[x] * e1[y] - s[y] * e1[x];
    }
    for (int k = 0; k < 3; k++) {
        det += e1[k] * p[k];
        u += s[k] * p[k];
        v += dir[k] * q[k];
        along += e2[k] * q[k];
    }
    if (!(fabs(det) > epsilon))
        return false;
    u /= det;
    v /= det;
    *t = along / det;
    return u >= 0 && v >= 0 && u + v <= 1 && *t > 0;
}
