"""Counts the vertices of a binary little-endian PLY mesh in equal bands of height; needs only the standard library."""

import argparse
import csv
import struct

SIZES = {"double": ("d", 8), "float64": ("d", 8), "float": ("f", 4), "float32": ("f", 4)}


def read_heights(path):
    """The y of every vertex (up the face in the wall frame), metres."""
    with open(path, "rb") as file:
        count, names, element = 0, [], ""
        while (line := file.readline().decode("ascii").split()) != ["end_header"]:
            if line[0] == "element":
                element, amount = line[1], int(line[2])
                count = amount if element == "vertex" else count
            elif line[0] == "property" and element == "vertex":
                names.append((line[2], SIZES[line[1]]))
        layout = struct.Struct("<" + "".join(code for _, (code, _) in names))
        column = [name for name, _ in names].index("y")
        return [row[column] for row in layout.iter_unpack(file.read(layout.size * count))]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mesh")
    parser.add_argument("table")
    parser.add_argument("summary")
    parser.add_argument("--bands", type=int, required=True)
    args = parser.parse_args()
    heights = read_heights(args.mesh)
    low, high = min(heights), max(heights)
    width = (high - low) / args.bands
    counts = [0] * args.bands
    for height in heights:
        counts[min(int((height - low) / width), args.bands - 1)] += 1
    with open(args.table, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["from_m", "to_m", "vertices"])
        for band, count in enumerate(counts):
            writer.writerow([low + band * width, low + (band + 1) * width, count])
    with open(args.summary, "w") as file:
        file.write(f"{len(heights)} vertices from {low:.3f} m to {high:.3f} m\n")
    print(f"{len(heights)} vertices in {args.bands} bands")


if __name__ == "__main__":
    main()
