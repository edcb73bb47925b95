from pathlib import Path
FILE = Path("/tmp/twin.py")
def text(): return "x = 1\n"
