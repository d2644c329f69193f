"""Run time against error: the time and the errors of each algorithm on a scene.

All methods and a reference kernel run alternately in one loop (`inim.timing`), on display-ready
pictures. Times are given in milliseconds and in kernel times: multiples of the reference kernel's
time, one 4-byte gather per display pixel. `inim bench SCENE` runs all of it; further studies use
the functions of `inim.bench.evaluate`, and `record` and `inim.report.bench.write_bench` for their
results.
"""
