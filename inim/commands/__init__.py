"""The commands, one a file; see `inim.cli` for what makes a module one."""
