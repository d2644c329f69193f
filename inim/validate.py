"""`python -m inim.validate scene.xml`; as an import, the function `inim.validate` itself."""

import sys

if __name__ == "__main__":
    from inim.cli.program import run

    run("validate")

from inim.pipeline.launch import validate

# `import inim.validate` binds what stands in sys.modules to `inim.validate`: keep the function.
sys.modules[__name__] = validate  # type: ignore[assignment]
