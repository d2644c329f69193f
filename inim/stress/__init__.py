"""The stress run: where the numbers can be trusted, and where they stop to be.

Every generator and lens model, in float32 and float64, is set against an oracle written from the
definitions alone (`oracle`, `first_hits`, `averages`, `optics_oracle`; rays in `rays` and
`free_rays`), over families of cases that push one parameter at a time to where arithmetic fails
(`cases`, `free_cases`, `optics_cases`). Relations that need no oracle are checked beside
(`relations`, `layer_relations`, `free_relations`, `optics_relations`), and what small errors of the
input cost is measured (`jitter`). From the cases follows, per parameter, the range inside which
results are safe (`regions`); `accuracy_limits` holds its limits for the warnings of other runs.
"""
