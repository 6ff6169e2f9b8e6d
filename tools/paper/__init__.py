"""The paper's examples redone: Chen, Tan and Huang, "Identification of Coulomb Friction-Impeded Systems With a
Triple-Relay Feedback Apparatus", IEEE Trans. Control Systems Technology, 2011, doi 10.1109/TCST.2011.2143413.

One module an example: ``compute`` makes its numbers, ``section`` its part of the page. `make paper` runs them all.
"""
