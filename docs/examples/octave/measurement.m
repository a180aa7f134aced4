function [h, H] = measurement (p, r, k, x)
% Compute h (m x 1) and H (m x n) of run r and epoch k at the state x (n x 1).
% p contains the arrays of a problem file.
% Derivatives are computed by complex steps, exact to rounding, without separate formulas.
  m = size (p.measurements, 3);
  n = numel (x);
  h = reshape (p.offset(r,k,:), m, 1);
  H = reshape (p.linear(r,k,:,:), m, n);
  h = h + H * x;
  g = size (p.combined, 3);
  if g > 0 && p.gain(r,k) ~= 0
    B = reshape (p.displacement(r,k,:,:), 6, []);
    b = size (B, 2);
    e = B * x(1:b);
    h(1:g) = h(1:g) + p.gain(r,k) * reading (p, r, k, e, g);
    for j = 1:3 + 3 * strcmp (p.instrument, 'strapdown')
      moved = e;
      moved(j) = moved(j) + 1e-20i;
      slope = imag (reading (p, r, k, moved, g)) / 1e-20;
      H(1:g,1:b) = H(1:g,1:b) + p.gain(r,k) * slope * B(j,:);
    end
  end
  W = reshape (p.weights(r,k,:,:), m, 3);
  if any (W(:)) && ~isempty (p.gravity_coefficients)
    at = reshape (p.ins_position(r,k,:), 1, 3);
    h = h + W * spline3 (p.gravity_origin, p.gravity_step, p.gravity_coefficients, ...
                         displaced (p, at, x(1:3)));
    for j = 1:3
      moved = x(1:3);
      moved(j) = moved(j) + 1e-20i;
      d = imag (spline3 (p.gravity_origin, p.gravity_step, p.gravity_coefficients, ...
                         displaced (p, at, moved))) / 1e-20;
      H(:,j) = H(:,j) + W * d;
    end
  end
end

function t = reading (p, r, k, e, g)
% sum of S T over the combined measurements; e: errors of position ENU [m] and attitude [rad]
  t = zeros (g, 1);
  for i = 1:size (p.lags, 2)
    if p.lags(k,i) < 0, continue, end
    q = k - p.lags(k,i);
    at = displaced (p, reshape (p.reading_positions(r,q,:), 1, 3), e(1:3));
    M = normal_gradient (p, at(1), at(3));
    if ~isempty (p.map_coefficients)
      v = spline3 (p.map_origin, p.map_step, p.map_coefficients, at);
      M = M + [v(1) v(2) v(3); v(2) v(4) v(5); v(3) v(5) v(6)];
    end
    if strcmp (p.instrument, 'platform')
      L = at(1); a = at(2) + p.ellipsoid(4) * p.reading_times(q);
      C = [-sin(a), -sin(L)*cos(a), cos(L)*cos(a);
            cos(a), -sin(L)*sin(a), cos(L)*sin(a);
            0, cos(L), sin(L)];
      M = C * M * C.';
    elseif strcmp (p.instrument, 'strapdown')
      C = (turn (e(4:6)) * reshape (p.reading_attitudes(r,k,:,:), 3, 3)).';
      M = C * M * C.';
    end
    S = reshape (p.combined(k,i,:,:), g, 6);
    t = t + S * [M(1,1); M(1,2); M(1,3); M(2,2); M(2,3); M(3,3)];
  end
end

function at = displaced (p, at, error)
% position minus a position error ENU [m]
  w2 = 1 - p.ellipsoid(2) * sin (at(1)) ^ 2;
  east = p.ellipsoid(1) / sqrt (w2);
  north = east * (1 - p.ellipsoid(2)) / w2;
  at = [at(1) - error(2) / (north + at(3)), ...
        at(2) - error(1) / ((east + at(3)) * cos (at(1))), at(3) - error(3)];
end

function v = spline3 (origin, step, c, at)
% cubic B-spline of all components (N x 1); outside the map, the value at the border
  for a = 1:3
    u = (at(a) - origin(a)) / step(a);
    cells = size (c, a) - 3;
    if real (u) < 0 || real (u) > cells, u = min (max (real (u), 0), cells); end
    first(a) = min (floor (real (u)), cells - 1);
    t = u - first(a);
    s = 1 - t;
    w{a} = [s^3, 4 + t^2 * (3*t - 6), 4 + s^2 * (3*s - 6), t^3] / 6;
  end
  box = c(first(1)+(1:4), first(2)+(1:4), first(3)+(1:4), :);
  box = w{1} * reshape (box, 4, []);
  box = w{2} * reshape (box, 4, []);
  v = (w{3} * reshape (box, 4, [])).';
end

function M = normal_gradient (p, L, height)
% gravitational gradient of the ellipsoid's zonal field in ENU [E]
  w2 = 1 - p.ellipsoid(2) * sin (L) ^ 2;
  N = p.ellipsoid(1) / sqrt (w2);
  x = (N + height) * cos (L);
  z = (N * (1 - p.ellipsoid(2)) + height) * sin (L);
  r = sqrt (x^2 + z^2);
  s = z / r; c = x / r;
  V = [-1, 0, 2, 0, 0];  % V_r r^2, V_s r, V_rr r^3, V_rs r^2, V_ss r, in units of GM
  P = [1, s]; D = [0, 1]; E = [0, 0];
  for n = 2:2 * numel (p.zonals)
    P(n+1) = ((2*n - 1) * s * P(n) - (n - 1) * P(n-1)) / n;
    D(n+1) = D(n-1) + (2*n - 1) * P(n);
    E(n+1) = E(n-1) + (2*n - 1) * D(n);
    if mod (n, 2) == 0
      f = p.zonals(n/2) * (p.ellipsoid(1) / r) ^ n;
      V = V + f * [(n+1) * P(n+1), -D(n+1), -(n+1) * (n+2) * P(n+1), (n+1) * D(n+1), -E(n+1)];
    end
  end
  V = V * p.ellipsoid(3) ./ [r^2, r, r^3, r^2, r];
  ee = V(1) / r - s * V(2) / r^2;
  nn = V(1) / r + (c^2 * V(5) - s * V(2)) / r^2;
  nu = c * (V(4) / r - V(2) / r^2);
  T = [sin(L)*c - cos(L)*s, cos(L)*c + sin(L)*s];  % sine and cosine of L minus geocentric latitude
  R = [T(2), -T(1); T(1), T(2)];
  G = R * [nn, nu; nu, V(3)] * R.';
  M = [ee, 0, 0; 0, G(1,1), G(1,2); 0, G(2,1), G(2,2)] * 1e9;
end

function C = turn (v)
% rotation matrix: exponential of the cross-product matrix of v (Rodrigues)
  angle2 = sum (v .^ 2);
  X = [0, -v(3), v(2); v(3), 0, -v(1); -v(2), v(1), 0];
  if abs (angle2) < 1e-12
    C = eye (3) + X + X * X / 2;
  else
    angle = sqrt (angle2);
    C = eye (3) + sin (angle) / angle * X + (1 - cos (angle)) / angle2 * X * X;
  end
end
