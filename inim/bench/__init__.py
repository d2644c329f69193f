"""The bench: how long each algorithm takes, and what it gets for it.

Every time is taken on the display-ready form (`inim.bench.contenders`), all contenders and the
yardstick in turn in one loop (`inim.bench.timing`), and given as a multiple of the yardstick
besides milliseconds. Six parts, each on its own or together: a scene, where time stands against
error (`scene`); synthetic pictures of growing size (`scaling`); the paper's own experiments
(`paper`); views by each lens model (`views`); several scenes with and without their layers
(`layers`); whole commands, cold and with something to find again (`commands`).
"""
