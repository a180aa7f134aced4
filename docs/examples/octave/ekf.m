function ekf (problem, estimates)
% Extended Kalman filter for Octave and MATLAB: ekf ('PROBLEM.mat', 'ESTIMATES.mat').
  p = load (problem);
  [R, K, m] = size (p.measurements);
  n = numel (p.prior_mean);
  mean = zeros (R, K, n);
  cov = zeros (R, K, n, n);
  for r = 1:R
    x = p.prior_mean(:);
    P = p.prior_cov;
    for k = 1:K
      F = reshape (p.transition(r,k,:,:), n, n);
      x = F * x;
      P = F * P * F' + reshape (p.process_cov(r,k,:,:), n, n);
      there = find (reshape (p.present(r,k,:), m, 1));
      if ~isempty (there)
        [h, H] = measurement (p, r, k, x);
        z = reshape (p.measurements(r,k,:), m, 1);
        N = reshape (p.noise_cov(k,:,:), m, m);
        H = H(there,:);
        N = N(there,there);
        G = P * H' / (H * P * H' + N);
        x = x + G * (z(there) - h(there));
        A = eye (n) - G * H;
        P = A * P * A' + G * N * G';
        P = (P + P') / 2;
      end
      mean(r,k,:) = x;
      cov(r,k,:,:) = P;
    end
  end
  times = p.times;
  problem = p.problem;
  causality = 'filter';
  estimator = 'octave-ekf';
  save ('-v7', estimates, 'mean', 'cov', 'times', 'problem', 'causality', 'estimator');
end
