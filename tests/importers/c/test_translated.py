"""C functions as graphs, compared with the same functions compiled by the C compiler of the system."""

import ctypes

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph.interpreter import evaluate
from kennfeld.models.function_files import read_function_file
from kennfeld.models.model_function import as_model
from tests.draws import mostly_slow
from tests.importers.c.compiled import compiled_step, needs_compiler

pytest.importorskip("pycparser")

LONG = {"break and return", "turns", "pointers that move"}  # programs of which every pass of a loop has several ends
PROGRAMS = {
    "break and return": """
        static const double X[5] = {-8, -1, 0.5, 2, 7}, Y[5] = {5, 4, -2, 8, 1};
        static int lookup(int x) {
            int i;
            for (i = 0; i < 4; i++) { if (x > 2 * i) { break; } if (x == i) { return 7; } }
            return i;
        }
        static int search(int x) {
            int low = 0, high = 15;
            while (low < high) {
                int middle = (low + high) / 2;
                if (middle * middle == x) return 100 + middle;
                if (middle * middle < x) low = middle + 1; else high = middle;
                if (high == 3) break;
            }
            return low;
        }
        double step(double u, int n, double *y) {
            int i;
            *y = lookup(n) + 10 * search(n);
            for (i = 0; i < 4; i++) {
                if (u < X[i]) return Y[i];
                if (u <= X[i + 1]) {
                    double share = (u - X[i]) / (X[i + 1] - X[i]);
                    if (share > 0.9) break;
                    return Y[i] + share * (Y[i + 1] - Y[i]);
                }
            }
            return Y[i] + 100;
        }""",
    "turns": """
        #include <math.h>
        double step(double u, int n, double *y) {
            double angle = 3 * u, count = 0;
            unsigned bits = (unsigned)n * 77u;
            while (angle > M_PI) { angle -= 2 * M_PI; count++; }
            while (angle < -M_PI) angle += 2 * M_PI;
            do { u -= 4; } while (u > 0);
            while (bits) { count += 10 * (bits & 1u); bits >>= 1; }
            *y = count;
            return angle + 100 * u;
        }""",
    "loops": """
        static const double table[4] = {1.0, 2.0, 4.0, 8.0};
        double step(double u, int n, double *y) {
            double sum = 0; int i;
            for (i = 0; i < 4; i++) { if (i == 2) continue; sum += table[i] * u; }
            do { sum = sum / 2; } while (i++ < 8 && sum > 3.0);
            for (i = 0; i < 12; i++) { if (sum < 1) break; sum *= 0.5; }
            *y = table[n & 3] + i;
            return sum;
        }""",
    "states": """
        #include <math.h>
        static int calls = 2;
        static double ring[3];
        static void shift(double x) { ring[2] = ring[1]; ring[1] = ring[0]; ring[0] = x; calls++; }
        double step(double u, int n, double *y) {
            static double filtered = 0.5;
            shift(u);
            if (n > 2) shift(-u);
            filtered += 0.25 * (u - filtered);
            *y = ring[0] + 10 * ring[2] + calls;
            return fmax(filtered, 0.0);
        }""",
    "switch": """
        enum mode { OFF, SLOW = 2, FAST };
        double step(double u, int n, double *y) {
            double r = 1;
            switch (n) {
            case OFF: r = -1; break;
            case 1: case SLOW: r += 10;
            case FAST: r += 100; break;
            case 4: if (u > 0) { r = 3; if (u > 4) break; r += u; } r *= 2; break;
            default: r = 7 / 2;
            }
            *y = n > 1 ? u : -u;
            return r;
        }""",
    "integers": """
        #include <stdint.h>
        double step(double u, int n, double *y) {
            static uint8_t count; static int16_t wide = 32000; uint32_t hash = 2166136261u;
            count += 100; wide += 500;
            hash = (hash ^ (uint32_t)(n + 7)) * 16777619u;
            hash ^= hash >> 13; hash = (hash << 5) | (hash >> 27);
            *y = count + wide + (n - 3) / 2 * 1000 + (n - 3) % 2;
            return (double)hash + (int8_t)(n * 77) + (n < 1u) + ~n + (unsigned char)u * 0;
        }""",
    "arguments": """
        #define SCALE 2.0 /* of a macro */
        static void both(double x, double *a, double *b) { *a = x + 1; *b = *b + SCALE * x; }
        static double sum(const double *values, int count) {
            double total = 0;
            for (int i = 0; i < count; i++) total += values[i];
            return total;
        }
        double step(double u, int n, double *y) {
            double p, q = 1, list[2][2] = {{1, 2}, {3}}, row[3] = {u, 2 * u};
            both(u, &p, &q);
            both(p, &row[2], &q);
            list[1][1] = q;
            *y = sum(row, 3) + list[0][1] + list[1][1];
            if (n > 3) return p;
            { double p = 5; q += p; }
            return q;
        }""",
    "effects": """
        static int calls;
        static double count(double x) { calls++; return x; }
        double step(double u, int n, double *y) {
            int before = n, more = 0;
            double r = (u > 0 && n++ > 1) ? count(u) : u - n--;
            if (n > 0 || (more = before) < 0) r += more++;
            for (int k = 0; k < 5 && n-- > 0; k++) r -= count(0.5);
            r += (n += 2, n) > 0 ? ++more : more--;
            *y = calls + 10 * more + 100 * n;
            return r;
        }""",
    "indices": """
        typedef struct { double x; double y; } Pair;
        static void next(double *value, int *at) { *value += 1; *at += 1; }
        double step(double u, int n, double *y) {
            double a[6] = {1, 2, 3, 4, 5, 6};
            Pair pairs[2] = {{u, 1}, {2, 3}};
            int i = n > 2, j = 0;
            double *first = &a[i];
            Pair *pair = &pairs[i];
            i++;
            a[i++] += u;
            a[i++] = a[j++] = 7;
            *first = -1;
            pair->y += 5;
            i = 1;
            next(&a[i], &i);
            a[i]--;
            *y = i + 10 * j + pairs[0].y - pairs[1].y;
            return a[0] + 10 * a[1] + 100 * a[2] + 1000 * a[3] + 1e4 * a[4] + 1e5 * a[5];
        }""",
    "ends": """
        #include <stddef.h>
        #include <math.h>
        double step(double u, int n, double *y) {
            static double ring[4];
            double list[] = {u, 1, 2 * u}, sum = 0, low;
            size_t i, count = sizeof(list) / sizeof(list[0]);
            for (i = 0; i < count; i++) sum += list[i];
            for (int k = 0; k < n; k++) ring[k] += u;
            for (int k = 3; k >= 0 && ring[k] == 0; k--) sum += k;
            low = fmin(u, 0.0 / 0.0) + fmax(sqrt(u), -1.0);
            *y = sum + ring[2];
            return low + (n > 0 && ring[n - 1] > 0 ? ring[n - 1] : 0);
        }""",
    "structs": """
        typedef struct { double x, y; double list[2]; } Pair;
        typedef struct { Pair first, second; int count; struct { double a; union { double b; double c; }; }; } Both;
        static Pair kept = {0.5, .list = {1, 2}};
        static Pair make(double x, int n) { Pair p = {x, n, {x + 1, n + 1}}; if (n > 2) p.y = -x; return p; }
        static Pair swapped(Pair p) { double x = p.x; p.x = p.y; p.y = x; return p; }
        static Pair limited(Pair p) { if (p.x > 2) return (Pair){ 2, .list[1] = p.y }; p.list[0] = 9; return p; }
        static double sum(const Pair *p) { return p->x + 10 * p->y + 100 * p->list[0] + 1000 * p->list[1]; }
        static double total(const double *x, int n) { double s = 0; for (int i = 0; i < n; i++) s += x[i]; return s; }
        static Both both(Pair p, double u) { Both b = { p, swapped(p), .count = 3, .c = u }; b.a = b.c + 1; return b; }
        double step(double u, int n, double *y) {
            Pair p = make(u, n), q = swapped(p), pairs[3] = { p, [2] = q };
            Both b = both(q, u);
            pairs[1] = n > 0 ? p : swapped(swapped(q));
            Pair again = limited(pairs[1]);
            pairs[0].list[1] = total((double[]){u, 1, 2}, 3) + make(u, n).list[0];
            kept = again = (u > 0 ? pairs[0] : kept);
            *y = sum(&kept) + b.second.x + b.first.list[1] + b.count + b.a;
            return sum(&pairs[n & 1]) + sum(&(Pair){u, .y = 2}) + sum(&again) + (int){n} + limited(q).list[1];
        }""",
    "unions": """
        typedef union { double array[3]; struct { double x, y, z; } axis; double rows[1][3]; } Vector;
        typedef struct { int kind; union { double number; int whole; struct { int a; double b[2]; } part; }; } Value;
        static Vector sum = {{1, 2, 3}};
        static Value last;
        static Vector added(Vector a, Vector b) {
            return (Vector){ .axis = { a.axis.x + b.axis.x, .y = a.axis.y + b.array[1], a.axis.z + b.axis.z } };
        }
        static void set(Value *v, double u, int n) {
            v->kind = n & 1;
            if (v->kind) v->number = u;
            else v->whole = (int)u;
        }
        static double get(const Value *v) { return v->kind ? v->number : v->whole; }
        double step(double u, int n, double *y) {
            Value values[2], plain = { 2, .part = { n, { u } } };
            Vector v = { .array = { u, 2 } };
            union { float f; int i; } word;
            double before = get(&last);
            word.i = n; word.f = word.i + 1;
            v.rows[0][2] = v.axis.y + n;
            v.array[n & 1] += 1;
            sum = added(sum, v);
            sum.axis.x *= 0.5;
            set(&values[0], u, n);
            set(&values[1], 2 * u, n + 1);
            last = values[n > 2];
            plain.part.b[1] = plain.part.a + word.f;
            *y = sum.array[0] + 10 * sum.rows[0][1] + 100 * sum.axis.z;
            return before + get(&values[0]) + get(&values[1]) + plain.part.b[0] + plain.part.b[1];
        }""",
    "mathematics": """
        #include <math.h>
        double step(double u, int n, double *y) {
            *y = sin(u) + atan2(u, 2) + fmod(u, 1.5) + hypot(u, n) + trunc(u) + rint(u) + copysign(3, u) + cbrt(u);
            return exp(-u) + pow(fabs(u), 1.5) + floor(u) + ceil(u) + round(u) + log1p(fabs(u)) + expm1(u / 9)
                   + fdim(u, 1)
                   + tanh(u) + log2(1 + u * u) + isnan(u) + M_PI * 0;
        }""",
    "parts": """
        #include <math.h>
        double step(double u, int n, double *y) {
            int low, high; double whole, s, c, v[4] = {u, 2, 3, n};
            long double wide = 3.0L * u;
            double rest = frexp(1e3 * u, &high) + frexp(1e-310 * u, &low) + modf(u, &whole);
            sincos(u, &s, &c);
            *y = high + 10 * low + 100 * whole + s + c + 2[v] + (n & 3)[v] + *(1 + v) + logb(u) + ilogb(u)
                + signbit(u) + 3 * isgreater(u, n) + 7 * islessgreater(u, n) + isunordered(u, 0.0) + isnormal(u);
            return rest + ldexp(u, n) + scalbln(1e-300 * u, 1030 + n) + ldexp(u * 1e-310, 4.9) + erf(u) + exp10(u / 9)
                + fma(u, u, -u * u) * 1e16 + remainder(u, 1.7) + fabsl(wide) + sizeof(wide) + isnan(nan(""));
        }""",
    "choices of addresses": """
        typedef struct { double gain, table[3]; } Values;
        static const Values COLD = {1.5, {1, 2, 3}}, WARM = {2.5, {4, 5, 6}};
        static const double LONG[5] = {1, 3, 9, 27, 81}, SHORT[2] = {-1, -2};
        static double ends(const double x[3]) { return x[0] + x[2]; }
        static void twice(double *x) { *x *= 2; }
        double step(double u, int n, double *y) {
            const Values *values = u > 0 ? &WARM : &COLD;
            static double kept = 3;
            kept += values->gain * u;
            double a = u, b = 2 * u, *p;
            if (n > 2) { p = &a; } else if (n > 0) { p = &b; *p += 1; } else { p = &kept; }
            *p += 10;
            for (int i = 0; i < 3; i++) {
                const double *q = (i & 1) ? LONG : SHORT;
                if (i == n) q = &LONG[2];
                kept += *q;
                if (kept > 20 * u) break;
            }
            p = &a;
            *p -= 1;
            *(u > 1 ? &kept : &b) = 7;
            twice(n == 1 ? &a : &b);
            *y = a + 100 * b + values->table[n & 1] + ends(u > 0 ? WARM.table : COLD.table);
            return kept + (n > 1 ? LONG : SHORT)[n & 1];
        }""",
    "memory": """
        #include <string.h>
        typedef struct { double x, y[3]; int k; } State;
        static const double FIRST[6] = {1, 2, 3, 4, 5, 6};
        double step(double u, int n, double *y) {
            double a[4] = {1, 2, 3, u}, b[4] = {5, 6, 7, 8}, m[2][3] = {{1, 2, 3}, {4, 5, 6}};
            State s = {u, {1, 2, 3}, n}, t[2] = {{1, {2, 3, 4}, 5}, {6, {7, 8, 9}, 10}};
            memset(a, 0, 2 * sizeof(double));
            memcpy(b, a, sizeof a - sizeof a[0]);
            memset(m, 0, sizeof m[0]);
            memset(s.y, 0, 2 * sizeof s.y[0]);
            memcpy(&t[1], &s, sizeof(State));
            memset(t, 0, sizeof *t);
            if (n > 2) memcpy(a, FIRST, sizeof a);
            memset(&s.k, 0, sizeof(int));
            memset(b, 0, 0);
            *y = a[0] + 10 * a[1] + 100 * a[2] + 1000 * a[3] + m[0][2] + 7 * m[1][1];
            return b[0] + 3 * b[2] + 5 * b[3] + s.y[1] + 2 * s.y[2] + 11 * t[0].y[1] + 13 * t[1].y[2] + t[1].k + s.k
                + '\\xff' + '\\101' + '\\0';
        }""",
    "pointers that move": """
        static const double T[6] = {1, -2, 4, 8, -16, 32};
        typedef struct { double x, y; } Pair;
        static const Pair PAIRS[4] = {{-3, 1}, {0, 2}, {2, 5}, {6, 9}};
        static double sum(const double *x, int n) { double s = 0; while (n--) s += *x++; return s; }
        static double between(const double *a, const double *e) { return e - a; }
        static void scale(double *x, int n, double k) { for (double *p = x; p < x + n; ++p) *p *= k; }
        static double first(const double *x) { return x[0] + 10 * x[1]; }
        double step(double u, int n, double *y) {
            double a[6], m[2][3] = {{1, 2, 3}, {4, 5, 6}}, *w = a, s = 0;
            const double *r = T + 1, *best = 0;
            const Pair *pair, *hit = 0;
            for (int i = 0; i < 6; i++) *w++ = T[i] * u + i;
            s += sum(a, 6) + 10 * (w - a);
            w -= 2; s += *w; *--w = 7; s += w[1] + *(w - 1) + w[-2];
            scale(a, 3, 2.0);
            scale(a + 2, 2, -1.0);
            s += a[0] + 3 * a[1] + 5 * a[2] + 7 * a[3] + 11 * a[4] + first(&a[3]) + first(w - 2);
            for (const double *p = T; p != T + 6; p += 2) s += *p * u;
            for (pair = PAIRS; pair < &PAIRS[3] && pair->x < u; pair++) ;
            s += pair->y + 100 * (pair - PAIRS);
            for (int i = 0; i < 4; i++) if (PAIRS[i].x > u) { hit = &PAIRS[i]; break; }
            if (hit) s += 1000 * hit->y; else s -= 1e4;
            if (hit != 0 && hit->y > 4) s += 3;
            if (n > 2) r = &T[3]; else r++;
            s += *r + r[1];
            w = &m[0][0];
            for (int i = 0; i < 6; i++) s += *w++ * (i + 1);
            w = m[1];
            w[1] = u; s += m[1][1]; w++; s += *w;
            best = T;
            for (const double *p = T; p < T + 6; p++) if (*p * u > *best * u) best = p;
            s += 1e5 * (best - T) + *best;
            { int k = n; const double *q = a; do { s += *q++; } while (k-- > 0 && q < a + 6); s += q - a; }
            *y = a[0] + a[2] - a[5] + m[0][0];
            return s + (r > T + 2) + first(&T[1]) + sum(T + 2, 3) + sum(m[1], 3);
        }""",
    "rare mathematics": """
        #include <math.h>
        double step(double u, int n, double *y) {
            static const double special[8] = {0.0, -0.0, 1.0, -1.0, 0.0 / 0.0, 1.0 / 0.0, 1e-310, 5e-324};
            double x = n < 0 ? u : special[n & 7]; int q = 77;
            double rest = remquo(u * 7, n - 2.25, &q), next = nexttoward(x, u);
            *y = lgamma(u) + lgamma(-1.0) * (n == 5) + erfc(9 - u) * 1e9;
            return rest + (q & 7) + fpclassify(x) * 10 + (fpclassify(x) == FP_NAN) + tgamma(u) / tgamma(u - 1)
                + (nextafter(u, n) - u) * 1e17 + (nextafter(4.0, -u) - 4.0) * 1e15
                + (isnan(next) ? 100 : next > 1e300 ? 200 : next * 1e20);
        }""",
    "long products": """
        #include <stdint.h>
        double step(double u, int n, double *y) {
            int a = (int)(u * 7e7), b = 1987654321 - n, d = (n + 3) * 70001;
            int64_t mask = (int64_t)a * 1000 + n;
            *y = (int32_t)(((int64_t)a * b) >> 31) + (int32_t)(((int64_t)a * b + 0x40000000) >> 31) * 3.0
                + (double)((0x8000 + (int64_t)b * d) >> 16) + (double)(((uint64_t)(uint32_t)a * (uint32_t)b) >> 33);
            mask ^= 0x5A5A5A5A5ALL; mask &= ~(int64_t)0xF0F; mask |= n & 7;
            return (double)((int64_t)a * b / (d | 1)) + (double)mask;
        }""",
    "memory within arrays": """
        #include <string.h>
        #include <stdint.h>
        typedef struct { int32_t a; float b; } Pair;
        static int total(const int32_t *p, int n) { int s = 0; while (n-- > 0) s = 3 * s + *p++; return s; }
        static float last(const Pair *p, int n) { const Pair *hit = NULL; for (; n > 0; n--, p++) if (p->a > 1) hit = p;
            return hit == NULL ? -1 : hit->b; }
        static void fill(uint8_t m[2][3], uint8_t x) {
            uint8_t *p = m[0];
            for (int i = 0; i < 6; ++i, x += 60) *(p++) = x;
        }
        double step(double u, int n, double *y) {
            int a[5] = {1, 2, 3, 4, 5}, b[3] = {7, 8, 9}, c[2][2] = {{1, 2}, {3, 4}}, *p = a, *q = &a[4], k = n & 1;
            static uint8_t m[2][3];
            Pair pairs[4] = {{1, u}, {2, 3}, {n, 4}, {0, 5}};
            memcpy(&a[2], b, 2 * sizeof(int));
            memcpy(a + 1, &b[1], sizeof b[0]);
            memset(c[1], 0, sizeof c[1]);
            fill(m, n);
            while (p < q) { int h = *p; *p++ = *q; *q-- = h; }
            p = k ? p + 1 : &a[0];
            p[0] += 10; p = p + k; *(p - k) *= 2;
            *y = last(pairs, 4) + 10 * last(pairs + 1, 2) + 100 * last(&pairs[3], 1);
            return total(a, 5) + total(a + 2, 3) + c[1][0] + m[1][2] + 7 * m[0][1]
                + 1e5 * (q - a) + 1e6 * (p - a);
        }""",
    "whole": """
        #include <math.h>
        double step(double u, int n, double *y) {
            *y = lround(u) / 2 + lrint(n / 2.0) * 100 + llround(-u) % 3;
            return lroundf(u + 0.25f) + llrintf(n * 0.5f) / 2;
        }""",
}


def _reference(source, folder, u, n):
    file = folder / "program.c"
    file.write_text(source)
    output = ctypes.POINTER(ctypes.c_double)
    step = compiled_step(file, ctypes.c_double, ctypes.c_double, ctypes.c_int, output)
    y, rows = ctypes.c_double(), []
    for a, b in zip(u.tolist(), n.astype(int).tolist(), strict=True):
        rows.append((step(a, b, ctypes.byref(y)), y.value))
    return np.array(rows).T


@needs_compiler
@pytest.mark.parametrize("program", mostly_slow(PROGRAMS, PROGRAMS.keys() - LONG))
def test_it_computes_what_the_compiler_makes_of_it(program, tmp_path):
    rng = np.random.default_rng(3)
    u, n = rng.normal(0.0, 5.0, 30), rng.integers(-2, 5 if program == "ends" else 6, 30).astype(float)
    value, y = _reference(PROGRAMS[program], tmp_path, u, n)
    model = as_model(read_function_file("program.c:step", tmp_path))
    columns = {"u": u, "n": n}
    nodes = evaluate(model.graph, {name: columns[name] for name in model.graph.inputs} | {"u": u}, ParameterSet())
    np.testing.assert_allclose(nodes["step"], value, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(nodes["y"], y, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(("call", "size"), [("memset(a, 0, 12)", 12), ("memcpy(a, b, 5 * sizeof(double))", 40)])
def test_a_size_in_bytes_that_is_not_that_of_elements_is_refused(call, size, tmp_path):
    (tmp_path / "f.c").write_text(
        f"double f(double u) {{\n    double a[4] = {{1, 2, 3, u}}, b[8] = {{0}};\n    {call};\n    return a[3];\n}}\n"
    )
    with pytest.raises(InputError, match=rf"line 3: \w+ of {size} bytes of a, which has 32, is not supported"):
        read_function_file("f.c:f", tmp_path)


def test_a_printed_variable_that_changes_is_refused_and_a_printed_one_is_not(tmp_path):
    for argument, is_supported in (("n", True), ("n++", False), ("n = 3", False)):
        source = f'double f(int n) {{\n    printf("%d", {argument});\n    return n;\n}}\n'
        (tmp_path / "f.c").write_text(f"#include <stdio.h>\n{source}")
        if is_supported:
            assert (
                evaluate(as_model(read_function_file("f.c:f", tmp_path)).graph, {"n": np.ones(1)}, ParameterSet())["f"]
                == 1
            )
        else:
            with pytest.raises(InputError, match="line 3: a variable that changes within the arguments of printf"):
                read_function_file("f.c:f", tmp_path)


def test_a_loop_without_a_known_end_is_followed_for_some_passes_with_a_remark(tmp_path):
    (tmp_path / "f.c").write_text("double f(double a, double b) {\n    while (a > 1) a -= 1;\n    return a + b;\n}\n")
    function = read_function_file("f.c:f", tmp_path)
    (remark,) = function.remarks
    assert (remark.location.line, remark.severity) == (2, "remark")
    assert "followed for 50 passes" in remark.message
    columns = {"a": np.array([0.5, 49.25, 1e9]), "b": np.zeros(3)}
    np.testing.assert_array_equal(evaluate(as_model(function).graph, columns, ParameterSet())["f"], [0.5, 0.25, np.nan])


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("float *p = (float *)&n; return *p;", "n consists of int, and its address is used as one of float"),
        ("double x[3] = {u}; return *(int *)x;", "x consists of double, and its address is used as one of int"),
        (
            "unsigned char *p; p = (void *)&u; return *p;",
            "u consists of double, and its address is used as one of unsi",
        ),
        ("double *p = &u; p++; return *p;", "u is a single object: an address in front of or behind it"),
        ("double a[2] = {u}, b[2] = {u}; return a < b;", "addresses of a and b are compared"),
        ("double a[2] = {u}; return total(a + n);", "the address that a function gets depends on signals"),
        ("double a[2] = {u}, *p = a; p += 2; return *p;", "an index is always out of range of its array"),
    ],
)
def test_an_address_that_leads_to_other_bytes_or_objects_is_refused(body, message, tmp_path):
    head = "static double total(const double *p) { return p[0] + p[1]; }\n"
    (tmp_path / "f.c").write_text(f"{head}double f(double u, int n) {{ {body} }}\n")
    with pytest.raises(InputError, match=f"line 2: {message}"):
        read_function_file("f.c:f", tmp_path)


def test_an_array_of_unknown_size_ends_where_that_of_the_caller_does(tmp_path):
    head = "static double sum(const double *p, int n) { double s = 0; while (n-- > 0) s += *p++; return s; }\n"
    (tmp_path / "f.c").write_text(f"{head}double f(int n) {{ double a[3] = {{1, 2, 4}}; return sum(a, n); }}\n")
    graph = as_model(read_function_file("f.c:f", tmp_path)).graph
    values = evaluate(graph, {"n": np.array([-1.0, 0, 2, 3])}, ParameterSet())["f"]
    np.testing.assert_array_equal(values, [0, 0, 3, 7])


def test_a_pointer_that_moves_out_of_its_array_by_signals_gives_nan(tmp_path):
    body = "static const double a[3] = {5, 6, 7}; const double *p = a; p += n; return *p;"
    (tmp_path / "f.c").write_text(f"double f(int n) {{ {body} }}\n")
    graph = as_model(read_function_file("f.c:f", tmp_path)).graph
    values = evaluate(graph, {"n": np.array([-1.0, 0, 2, 3])}, ParameterSet())["f"]
    np.testing.assert_array_equal(values, [np.nan, 5, 7, np.nan])


@pytest.mark.parametrize(
    "statements",
    [
        "for (p = &a; u > 0; p = &b) u -= *p;",
        "for (int i = 0; i < 3; i++) { u += *p; p = &b; }",
        "switch (n) { case 0: p = &a; break; case 1: u = *p; break; }",
        "while (u > *p) { p = &b; u -= 1; }",
    ],
)
def test_a_pointer_that_a_loop_or_switch_sets_is_refused_where_its_address_is_not_known(statements, tmp_path):
    source = (
        f"double step(double u, int n) {{\n    double a = 1, b = 2, *p = &a;\n    {statements}\n    return u;\n}}\n"
    )
    (tmp_path / "f.c").write_text(source)
    with pytest.raises(InputError, match="the pointer p is set in a loop or switch and used elsewhere"):
        read_function_file("f.c:step", tmp_path)
