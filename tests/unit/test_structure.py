"""The package's modules import one another in one direction, functions' own imports included."""

from graphlib import TopologicalSorter

import grimp


def test_no_import_circle():
    graph = grimp.build_graph("inim", exclude_type_checking_imports=True, cache_dir=None)
    assert len(graph.modules) > 100, "or this test looks at nothing"
    imports = {name: graph.find_modules_directly_imported_by(name) for name in graph.modules}
    TopologicalSorter(imports).prepare()  # raises CycleError with the modules of a circle
