function out = motor_simulate(varargin)
% MOTOR_SIMULATE  The motor of motor.mat, simulated. For MATLAB and Octave; no toolbox.
%
%   motor_simulate                    plots the recorded run beside its simulation from the first row, at rest
%   out = motor_simulate('relay-2')   the rows of that stage alone, simulated from the first row of the run, too
%   out = motor_simulate(t_s, u_V, y0_rad, v0_rad_s)   a drive of your own: u_V(k) acts from t_s(k) to t_s(k+1)
%
% out.t_s, out.y_rad   times, s, and what the sensor shows, rad
% out.v_rad_s          velocity, rad/s
% out.recorded_rad     what it showed in the recording, rad, and out.rms_rad the difference's root mean square
%
%   tau dv/dt + v = K (w + bias - G(y) - F - beta |v| - c v |v|),   dy/dt = v
%
% w is the drive behind its stage (dead band, gain by sign, sag, lag), G the force over position, F the friction. With
% bristles F is a state: dF/dt = s (v - |v| F / level), s their stiffness. With backlash y0_rad and out.y_rad are of the
% sensor's side, which stands in the middle of the play at the start, or behind a shaft that moves. Stick, slip and
% reversal are exact events; between them RK4. Numbers, units, intervals and source: load('motor.mat').motor.

here = fileparts(mfilename('fullpath'));
file = load(fullfile(here, 'motor.mat'));
m = file.values;
if nargin == 4
    out = simulated(m, varargin{1}(:), varargin{1}(:), varargin{2}(:), varargin{3}, varargin{4});
    return
end
if nargin > 1
    error('motor_simulate:arguments', 'give nothing, a stage, or t_s, u_V, y0_rad, v0_rad_s');
end
s = file.samples;
rows = (1:numel(s.t_s))';
stage = 'whole run';
if nargin == 1
    stage = varargin{1};
    rows = find(strcmp(s.stage, stage));
end
if isempty(rows)
    error('motor_simulate:stage', 'motor.mat has no stage %s; it has %s', stage, strjoin(unique(s.stage)', ', '));
end
upto = (1:rows(end))';
edges = s.t_u_s(upto);
edges(isnan(edges)) = s.t_s(isnan(edges));
whole = simulated(m, s.t_s(upto), edges, s.u_V(upto), s.y_rad(1), 0);
out.t_s = whole.t_s(rows);
out.y_rad = whole.y_rad(rows);
out.v_rad_s = whole.v_rad_s(rows);
out.recorded_rad = s.y_rad(rows);
out.rms_rad = sqrt(mean((out.y_rad - out.recorded_rad) .^ 2));
if nargout == 0
    subplot(2, 1, 2);
    plot(out.t_s, 1e3 * (out.recorded_rad - out.y_rad));
    xlabel('t, s');
    ylabel('recorded - simulated, mrad');
    subplot(2, 1, 1);
    plot(out.t_s, out.recorded_rad, out.t_s, out.y_rad);
    legend('recorded', 'simulated');
    ylabel('position, rad');
    title(sprintf('%s, %s: rms %.4f rad', file.motor.run, stage, out.rms_rad), 'Interpreter', 'none');
end
end

function out = simulated(m, t_s, edges_s, u_V, y0, v0)
% Readings at t_s; drive u_V(k) from edges_s(k) on, and before its first edge the first one.
n = numel(t_s);
out.t_s = t_s;
out.y_rad = zeros(n, 1);
out.v_rad_s = zeros(n, 1);
x = start(m, v0, y0);
for k = 1:n
    out.y_rad(k) = reading(m, x(5));
    out.v_rad_s(k) = x(1);
    if k == n
        break
    end
    before = u_V(max(k - 1, 1));
    change = min(max(edges_s(k) - t_s(k), 0), t_s(k + 1) - t_s(k));
    x = advance(m, x, before, change);
    x = advance(m, x, u_V(k), t_s(k + 1) - t_s(k) - change);
end
end

function x = start(m, v0, y0)
% The state [velocity, position, drive behind the lag, friction of bristles, position of the sensor's side].
most = level_of_bristles(m, abs(v0), y0);
friction = min(max(m.bias_V - force(m, y0), -most), most); % at rest bristles balance the other forces
if v0 ~= 0
    friction = sign(v0) * most;
end
x = [v0, y0 + 0.5 * sign(v0) * m.backlash_rad, 0, friction, y0];
end

function x = advance(m, x, u, dt)
% The state dt later under a constant drive u, event by event.
drive = stage_of(m, u);
if m.lag_s <= 0
    x(3) = drive;
end
left = dt;
while left > 0
    way = direction(m, x, drive);
    if way == 0
        h = min(left, release(m, x, drive, left));
        x(3) = lagged(m, drive, x(3), h);
        if h < left % from here on it moves
            way = sign(x(3) + m.bias_V - force(m, x(2)));
            [x, step] = slide(m, way, x, drive, left - h);
            h = h + step;
        end
    else
        [x, h] = slide(m, way, x, drive, left);
    end
    if way ~= 0 % at the end of the play the sensor's side is taken along
        x(5) = way * max(way * x(5), way * x(2) - 0.5 * m.backlash_rad);
    end
    left = left - h;
end
end

function way = direction(m, x, drive)
if x(1) ~= 0
    way = sign(x(1));
    return
end
pull = x(3) + m.bias_V - force(m, x(2));
if m.bristle_V_rad > 0
    held = 1e-12; % bristles that pull less than this rest
    pull = pull - x(4);
    if abs(pull) <= held && m.lag_s > 0
        pull = drive - x(3);
    end
else
    held = level(m, 0, x(2)) + m.static_V;
end
way = sign(pull) * (abs(pull) > held);
end

function h = release(m, x, drive, most)
% Time until a lagging drive passes the level that holds the shaft.
h = Inf;
if m.lag_s <= 0 || m.bristle_V_rad > 0
    return
end
held = level(m, 0, x(2)) + m.static_V;
constant = m.bias_V - force(m, x(2));
for wanted = [held - constant, -held - constant]
    if min(x(3), drive) < wanted && wanted < max(x(3), drive)
        h = min(h, m.lag_s * log((x(3) - drive) / (wanted - drive)));
    end
end
end

function [x, h] = slide(m, way, x, drive, most)
% A step in one direction, at most that long: to its end, or to where the shaft stops.
h = min(most, longest(m, way, x));
last = runge_kutta(m, way, x, drive, h);
if way * last(1) > 0
    x = last;
    return
end
if x(1) == 0 % in balance: it stays
    x(3) = last(3);
    return
end
low = 0;
high = h;
for i = 1:50
    middle = 0.5 * (low + high);
    last = runge_kutta(m, way, x, drive, middle);
    if way * last(1) > 0
        low = middle;
    else
        high = middle;
    end
end
h = high;
x = runge_kutta(m, way, x, drive, h);
x(1) = 0;
end

function x = runge_kutta(m, way, x, drive, h)
% Classical RK4; bristles, which near their level fast, by its exponential form (Cox and Matthews 2002).
v = x(1);
y = x(2);
f = x(4);
w2 = lagged(m, drive, x(3), 0.5 * h);
w4 = lagged(m, drive, x(3), h);
fade = 0;
if m.bristle_V_rad > 0 % rate at which they near their level in the middle of the step
    speed = max(way * (v + 0.5 * h * acceleration(m, way, v, y, x(3), f)), 0);
    most = level_of_bristles(m, speed, y);
    fade = stiffness(m, most) * speed / most;
end
[keep, half, near, b1, b2, b4] = weights(h * fade);
near = 0.5 * h * near;
a1 = acceleration(m, way, v, y, x(3), f);
n1 = bending(m, v, y, f) + fade * f;
v2 = v + 0.5 * h * a1;
y2 = y + 0.5 * h * v;
f2 = half * f + near * n1;
a2 = acceleration(m, way, v2, y2, w2, f2);
n2 = bending(m, v2, y2, f2) + fade * f2;
v3 = v + 0.5 * h * a2;
y3 = y + 0.5 * h * v2;
f3 = half * f + near * n2;
a3 = acceleration(m, way, v3, y3, w2, f3);
n3 = bending(m, v3, y3, f3) + fade * f3;
v4 = v + h * a3;
y4 = y + h * v3;
f4 = half * f2 + near * (2 * n3 - n1);
a4 = acceleration(m, way, v4, y4, w4, f4);
n4 = bending(m, v4, y4, f4) + fade * f4;
x = [v + h / 6 * (a1 + 2 * (a2 + a3) + a4), y + h / 6 * (v + 2 * (v2 + v3) + v4), w4, ...
    keep * f + h * (b1 * n1 + b2 * (n2 + n3) + b4 * n4), x(5)];
end

function [keep, half, near, b1, b2, b4] = weights(c)
% Of the exponential form for a step of c time constants; at 0 those of RK4.
if c < 0.5
    p4 = 1;
    for k = 12:-1:5
        p4 = 1 - c / k * p4;
    end
    p4 = p4 / 24;
else
    p4 = ((((1 - exp(-c)) / c - 1) / -c - 0.5) / -c - 1 / 6) / -c;
end
p3 = 1 / 6 - c * p4;
p2 = 0.5 - c * p3;
p1 = 1 - c * p2;
keep = 1 - c * p1;
half = sqrt(keep);
near = 2 * p1 / (1 + half);
b1 = p1 - 3 * p2 + 4 * p3;
b2 = 2 * p2 - 4 * p3;
b4 = 4 * p3 - p2;
end

function a = acceleration(m, way, v, y, w, f)
friction = f;
if m.bristle_V_rad <= 0
    friction = way * level(m, abs(v), y);
end
viscous = abs(v) * (m.viscous_by_direction_V_s_rad + m.drag_V_s2_rad2 * v);
a = (m.K_rad_s_V * (w + m.bias_V - force(m, y) - friction - viscous) - v) / m.tau_s;
end

function rate = bending(m, v, y, f)
% Rate of the friction of bristles, V/s; 0 without bristles.
rate = 0;
if m.bristle_V_rad > 0
    most = level_of_bristles(m, abs(v), y);
    rate = stiffness(m, most) * (v - abs(v) * f / most);
end
end

function s = stiffness(m, most)
% Of bristles that slide at this level: after at least 0.1 mrad, V/rad.
s = min(m.bristle_V_rad, most / 1e-4);
end

function f = level_of_bristles(m, speed, y)
f = max(level(m, speed, y), 1e-4);
end

function h = longest(m, way, x)
% Longest step with a small error.
h = m.tau_s / 20;
if m.lag_s > 0
    h = min(h, m.lag_s / 5);
end
pull = abs(acceleration(m, way, x(1), x(2), x(3), x(4))) + 1e-9;
if m.stribeck_rad_s > 0 && abs(x(1)) < 12 * m.stribeck_rad_s
    h = min(h, 0.2 * m.stribeck_rad_s / pull);
end
distance = Inf;
if any([m.force_sin_V, m.force_cos_V, m.friction_sin_V, m.friction_cos_V, m.cogging_sin_V, m.cogging_cos_V] ~= 0)
    distance = 0.15 / max(1, abs(m.cogging_per_rad));
end
if m.bristle_V_rad > 0 % the nearer they are to sliding, the less they matter
    most = level_of_bristles(m, abs(x(1)), x(2));
    stiff = stiffness(m, most);
    left = min(max(abs(1 - way * x(4) / most), 1e-8), 2) + 60 * (abs(m.friction_sin_V) + abs(m.friction_cos_V)) / stiff;
    if m.stribeck_rad_s > 0
        left = left + abs(m.stribeck_V) * exp(-abs(x(1)) / m.stribeck_rad_s) / most;
    end
    distance = min(distance, 0.25 * most / stiff * left ^ -0.25);
    h = min(h, 0.04 * sqrt(m.tau_s / (m.K_rad_s_V * stiff * left)));
end
if isfinite(distance)
    h = min(h, 2 * distance / (abs(x(1)) + sqrt(x(1) ^ 2 + 2 * pull * distance)));
end
end

function w = lagged(m, drive, w, h)
if m.lag_s > 0
    w = drive + (w - drive) * exp(-h / m.lag_s);
else
    w = drive;
end
end

function w = stage_of(m, u)
% Drive behind dead band, gain by sign and sag.
rest = max(abs(u) - m.dead_band_V, 0);
w = rest * (1 + sign(u) * m.gain_by_sign);
w = sign(u) * w * (1 - m.sag_per_V * w);
end

function f = level(m, speed, y)
% Level of the friction in motion.
f = m.fc_V + over_travel(m, y, m.friction_sin_V, m.friction_cos_V);
if m.stribeck_rad_s > 0
    f = f + m.stribeck_V * exp(-speed / m.stribeck_rad_s);
end
end

function g = force(m, y)
q = m.cogging_per_rad * y;
g = over_travel(m, y, m.force_sin_V, m.force_cos_V) + m.cogging_sin_V * sin(q) + m.cogging_cos_V * cos(q);
end

function g = over_travel(m, y, sine, cosine)
g = 0;
if sine ~= 0 || cosine ~= 0
    q = y - m.centre_rad;
    g = sine * sin(q) + cosine * (cos(q) - sin(m.half_travel_rad) / m.half_travel_rad);
end
end

function r = reading(m, y)
% What the sensor shows at the position y.
r = y;
if m.half_travel_rad > 0
    share = (y - m.centre_rad) / m.half_travel_rad;
    q = pi * share;
    r = y + m.linearity_sin1_rad * (sin(q) - 3 / pi * share) + m.linearity_cos1_rad * cos(q) ...
        + m.linearity_sin2_rad * (sin(2 * q) + 1.5 / pi * share) + m.linearity_cos2_rad * cos(2 * q);
end
end
