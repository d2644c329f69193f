"""The accuracy study: where the project's own generators and lens models are safe, and where not.

Every generator and lens model, in float32 and float64, is set against an oracle written from its
definition alone (`oracles`, `lens_oracle`; rays in `rays`), over families of cases that push one
parameter at a time to where arithmetic fails (`cases`, `lens_cases`). Relations that need no oracle
are those of `inim.stress`, and more of layers, implementations and lens models (`relations`,
`lens_relations`). From the cases follows, per parameter, the range inside which results are safe
(`limits`): `inim.inspect.accuracy_limits` holds these limits for the warnings of validations, and
a test compares the two.

From the root of the repository::

    python -m reports.stress.study -o reports/stress

The tests import this package, too: its oracles are the only ones of their kind, except the rational
first hit, which the product has (`inim.generators.oracle`) and `tests/oracle.py` has once more.
"""
