"""`python -m inim.validate scene.xml`; as an import, the function `inim.validate` itself."""

import sys

if __name__ == "__main__":
    if not getattr(sys.flags, "safe_path", False):
        del sys.path[0]  # the current folder: nothing in it is meant to be imported
    from inim.cli import main

    sys.exit(main(["validate", *sys.argv[1:]]))

from inim.pipeline.validation import validate

# `import inim.validate` binds what stands in sys.modules to `inim.validate`: keep the function.
sys.modules[__name__] = validate  # type: ignore[assignment]
