"""Accuracy study: safe parameter ranges of the project's generators and lens models.

Every generator and lens model is compared, in float32 and float64, with an oracle that is written
from its definition (`oracles`, `lens_oracle`; rays in `rays`). Each family of cases varies one
parameter until arithmetic fails (`cases`, `lens_cases`). Relations without an oracle are those of
layers, number types and lens models (`relations`, `lens_relations`); `inim stress` has those of
every algorithm. The cases give the safe range of each parameter (`limits`).
`inim.generators.accuracy_limits` contains these limits for the warnings of validations, and a test
compares the two.

From the root of the repository::

    python -m reports.stress.study -o reports/stress

The tests also import this package and its oracles. Rational first hits are in
`inim.generators.oracle` and, independently, in `tests/oracle.py`.
"""
