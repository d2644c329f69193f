"""The package's modules import one another in one direction, functions' own imports included."""

import sys
from graphlib import TopologicalSorter
from importlib import metadata

import grimp
import pytest

from inim.pipeline.stages.stage import GENERATING, RENDERING, SCORING
from inim.system.cache import PACKAGES

# Packages that draw the terminal, run tests or share tasks, and optional ones with an own record.
NOT_COMPUTING = {"argcomplete", "dask", "distributed", "pyarrow", "pytest", "tqdm"}
OPTIONAL = {"pandas", "pillow_heif", "tomli", "torch", "transformers"}
# Imported by trimesh, for compressed meshes.
INDIRECT = {"DracoPy"}
# Packages of the program that affect no pixel and no score, or whose effect is part of the keys:
# backend and plugins.
WITHOUT_EFFECT = {"system", "scores.document_parts", "scores.regression.document"}


@pytest.fixture(scope="module")
def graph():
    return grimp.build_graph(
        "inim",
        include_external_packages=True,
        exclude_type_checking_imports=True,
        cache_dir=None,
    )


def test_no_import_circle(graph):
    assert len(graph.modules) > 100, "or this test looks at nothing"
    imports = {name: graph.find_modules_directly_imported_by(name) for name in graph.modules}
    TopologicalSorter(imports).prepare()  # raises CycleError with the modules of a circle


def test_versions_of_all_imported_packages_are_part_of_every_result(graph):
    """A package in none of the lists is new: decide whether it computes anything."""
    names = {module.partition(".")[0] for module in graph.modules} - {"inim"}
    owners = metadata.packages_distributions()
    external = {
        name if name in OPTIONAL else owners.get(name, [name])[0]
        for name in names - sys.stdlib_module_names
    }
    assert len(external) > 10, "or this test looks at nothing"
    assert external - NOT_COMPUTING - OPTIONAL | INDIRECT == set(PACKAGES)


@pytest.mark.parametrize("code", [RENDERING, GENERATING, SCORING])
def test_code_of_a_result_includes_all_that_it_imports(graph, code):
    counted = tuple(f"inim.{path.removesuffix('.py').replace('/', '.')}" for path in code.paths)
    imported = {
        (importer, name)
        for importer in graph.modules
        if f"{importer}.".startswith(tuple(f"{prefix}." for prefix in counted))
        for name in graph.find_modules_directly_imported_by(importer)
        if name.startswith("inim.")
    }
    assert len(imported) > 20, "or this test looks at nothing"
    ignored = tuple(f"inim.{name}." for name in WITHOUT_EFFECT)
    counted_or_ignored = (*(f"{prefix}." for prefix in counted), *ignored)
    assert not {pair for pair in imported if not f"{pair[1]}.".startswith(counted_or_ignored)}
