"""Reading and writing of files, without the renderer."""
