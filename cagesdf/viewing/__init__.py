"""The editor in the browser: drag the cuboids, slide the style, see the surface.

snapping.py   a cuboid that is dragged near another one comes into contact with it
styles.py     ways through the space of codes: principal directions
drawing.py    new styles and shapes, drawn until one holds
worker.py     surfaces in the background: a coarse one while the hand moves, a fine one when it rests
jobs.py       long work: how far it is, and its end
thumbnails.py pictures of surfaces, drawn in the background
picking.py    which cuboids are under the mouse
colours.py    a colour for parts that belong together, and the selection's
framing.py    where the camera stands
angles.py     a cuboid's rotation as three numbers
parameters.py plain names of a program's numbers
keys.py       which key does what
scene.py      what is seen: surface, cuboids, gizmo and handles
pictures.py   a grid of pictures to click
panel.py      what is read, typed and clicked beside it
partlist.py   the list of parts at the other side
shelf.py      the documents of a tab, by name
drafts.py     work that outlives its page
leaving.py    a page that asks before it is left
tab.py        one browser tab: document, worker, scene and panel together
files.py      what comes in and goes out through the browser
server.py     the address; a tab for each visitor
"""
