"""The panel: the bench live in a browser. A process of its own, which no loop ever waits for.

access    who may watch and who may drive: token, cookie, password, Host, Origin, security headers
app       the pages, the JSON and the WebSocket
sockets   what one WebSocket may cost
messages  all that a page is told, as types
watch     what the pages are told of a run, 25 times a second
bench     checks, starts, calibrates, jogs and stops
calibration  a calibration that a page goes through, and the panel's promise to be there, without which it drives
          nothing; calibrating: the process that does it
processes the commands that were started, found again by a later panel
aside     what takes a second, in a process of low priority
prospect  what `rig check` says of a config, as JSON
runs      past runs; series: one of them, thin enough to draw, and whether several are of one motor
serve     the server: address, certificate, the process itself
"""
