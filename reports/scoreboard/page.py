def page(results): return "x"
