"""The test program and the Makefile of an exported filter."""

import textwrap
from typing import Any

import numpy as np

from sigmax.export.c99 import literal
from sigmax.export.source import Names, identifier
from sigmax.export.vectors import Vectors

_HELPERS = """\
/* Differences are measured in standard deviations, and against the size of the number. */
static double apart(REAL mine, REAL theirs, double scale) {
    if (isnan(mine) && isnan(theirs)) return 0;
    if (isnan(mine) || isnan(theirs)) return INFINITY;
    return fabs((double)mine - (double)theirs) / (fabs((double)theirs) + scale);
}

static int seen(const REAL *z, int size) {
    int i, found = 0;
    for (i = 0; i < size; i++) found |= !isnan(z[i]);
    return found;
}
"""

_MAIN = """\
int main(void) {
    PREFIX_state s;
    double worst = 0;
    int t, i, j, fault = PREFIX_start(&s, prior_mean, prior_cov);
    for (t = 0; t < STEPS; t++) {
        const REAL *S = factor + TRIANGLE * t;
        REAL said = 0;
        fault |= PREFIX_predict(&s, dt[t]GIVEN);
UPDATES
OF_NUMBERS        for (i = 0; i < ROWS; S += ++i) {
            double size = 0;
            for (j = 0; j <= i; j++) size += (double)S[j] * (double)S[j];
            size = sqrt(size);
OF_ROWS            for (j = 0; j <= i; j++)
                worst = fmax(worst, apart(s.factor[i * (i + 1) / 2 + j], S[j], size));
        }
        if (!isnan(nis[t])) worst = fmax(worst, apart(said, nis[t], 1));
    }
    printf("PREFIX: STEPS steps, largest difference %.2g (at most %.0e), faults %d\\n", worst, TOLERANCE, fault);
    return !(worst <= TOLERANCE) || fault;
}
"""

# A number of the mean is held against the standard deviation of its row of the factor; the numbers of curved parts
# have no row of their own, and are held against 1.
_OF_ROWS = "            worst = fmax(worst, apart(s.mean[i], mean[SIZE * t + i], size));\n"
_OF_NUMBERS = "        for (i = 0; i < SIZE; i++) worst = fmax(worst, apart(s.mean[i], mean[SIZE * t + i], 1));\n"

_UPDATE = """\
        if (seen(z_SENSOR + COUNT * t, COUNT)) {
            FUNCTION_told told;
            fault |= FUNCTION(&s, z_SENSOR + COUNT * tGIVEN, &told);
            if (told.dof > 0) said += told.nis;
        }"""

_MAKEFILE = """\
CC ?= cc
CFLAGS ?= -O2
STRICT = -std=c99 -Wall -Wextra -pedantic -Werror

.PHONY: test clean

test: test_PREFIX
\t./test_PREFIX

test_PREFIX: test_PREFIX.c PREFIX.c PREFIX.h
\t$(CC) $(STRICT) $(CFLAGS) -o $@ test_PREFIX.c PREFIX.c $(LDFLAGS) -lm

clean:
\trm -f test_PREFIX
"""


def _filled(text: str, **places: Any) -> str:
    for place, value in places.items():
        text = text.replace(place, str(value))
    return text


def test_program(names: Names, vectors: Vectors, prior: Any, single: bool) -> str:
    """A program that runs the filter over recorded inputs and compares with recorded outputs."""
    real, n, T = "float" if single else "double", names.n, len(vectors.rows.dt)
    i, j = np.tril_indices(n)
    flat = names.points == n
    values = {"prior_mean": prior.mean, "prior_cov": prior.cov, "dt": vectors.rows.dt}
    values |= {} if vectors.rows.u is None else {"u": vectors.rows.u}
    values |= {f"z_{identifier(s)}": z for s, z in vectors.rows.z.items()}
    values |= {"mean": vectors.mean, "factor": vectors.factor[:, i, j], "nis": vectors.nis}
    given = f", u + {names.inputs} * t" if names.inputs else ""
    updates = [
        _filled(_UPDATE, SENSOR=identifier(s), COUNT=len(parts), FUNCTION=names.update(s), GIVEN=given)
        for s, parts in names.sensors.items()
    ]
    main = _filled(
        _MAIN,
        STEPS=T,
        OF_NUMBERS="" if flat else _OF_NUMBERS,
        OF_ROWS=_OF_ROWS if flat else "",
        TRIANGLE=names.triangle,
        SIZE=names.points,
        ROWS=n,
        GIVEN=given,
        TOLERANCE=repr(vectors.tolerance),
        REAL=real,
        PREFIX=names.prefix,
        UPDATES="\n".join(updates),
    )
    return "\n".join(
        [
            f"/* Runs {names.prefix} over {T} recorded steps and compares with what sigmax computed in Python. */",
            f'#include "{names.prefix}.h"\n\n#include <math.h>\n#include <stdio.h>\n',
            *(_table(name, value, real) for name, value in values.items()),
            _filled(_HELPERS, REAL=real),
            main,
        ]
    )


def _table(name: str, values: np.ndarray, real: str) -> str:
    flat = ", ".join(literal(x, real == "float") for x in np.ravel(values))
    body = "\n".join(textwrap.wrap(flat, 116, initial_indent="    ", subsequent_indent="    "))
    return f"static const {real} {name}[] = {{\n{body}\n}};\n"


def makefile(prefix: str) -> str:
    """Builds with warnings as errors; `make test` compares with the recorded outputs."""
    return _filled(_MAKEFILE, PREFIX=prefix)
