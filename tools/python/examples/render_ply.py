"""One splat file, one image: opens the splats, puts a camera where it sees them all, and writes a PNG.

python3 tools/python/examples/render_ply.py garden.ply garden.png
"""

import sys

import decouplegs

if len(sys.argv) != 3:
    sys.exit("usage: render_ply.py SPLATS IMAGE.png")
splats, out = sys.argv[1:]
session = decouplegs.Session()
scene = session.open_scene(splats)
camera = scene.frame(size=(1280, 720))
images = session.batch_renderer().draw([(decouplegs.World(scene), [camera])])[0]
decouplegs.save_png(out, images[0])
print(f"{out}: {camera.width}x{camera.height} pixels")
