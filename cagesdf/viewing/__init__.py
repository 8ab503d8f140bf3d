"""The editor in the browser: drag the cuboids, slide the style, see the surface.

Records:
opening.py    runs from folders, for all tabs
uploads.py    shapes from users' files, and their parts as they were changed
files.py      uploads and downloads
shelf.py      the documents of a tab, by name
drafts.py     work that outlives its page
selection.py  parts that are selected, hidden, locked
workspace.py  the open document with its selection, and steps back and forth
styles.py     principal directions of the codes
parameters.py plain names of a program's numbers
keys.py       which key does what

Input:
picking.py    which cuboids are under the mouse
hand.py       operations of a gizmo, a face, typed numbers
snapping.py   contact of a cuboid that is dragged near another one
angles.py     a cuboid's rotation as three numbers
fields.py     boxes for numbers
settling.py   numbers that are being typed
sliding.py    controls that go on being changed

Background work:
worker.py     surfaces in the background: a coarse one while the hand moves, a fine one when it rests
jobs.py       long work: its progress and its end
drawing.py    new styles and shapes, drawn until one holds
thumbnails.py pictures of surfaces, drawn in the background

Display:
scene.py      surface, cuboids, gizmo and handles
framing.py    where the camera stands
colours.py    a colour for parts that belong together, and the selection's
panel.py      what is read, typed and clicked beside it
partlist.py   the list of parts at the other side
dissecting.py the page for the parts of a whole mesh
pictures.py   a grid of pictures to click
gallery.py    pictures of styles and directions
refusals.py   errors in the page
leaving.py    a page that asks before it is left

tab.py        one browser tab: all of these together
server.py     the address; a tab for each visitor
"""
