/* CHOLMOD with METIS, supernodal, on the lower triangle of a matrix by columns:
     cholmod PREFIX REPEAT
   reads PREFIX.ptr, PREFIX.col (int32) and PREFIX.val (float64) and prints its seconds as JSON.
   cc -O2 cholmod.c -lcholmod -o cholmod; threads are those of the BLAS (OPENBLAS_NUM_THREADS). */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <suitesparse/cholmod.h>
#include <time.h>

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

static void *read_all(const char *prefix, const char *extension, size_t *bytes) {
    char path[4096];
    snprintf(path, sizeof path, "%s.%s", prefix, extension);
    FILE *file = fopen(path, "rb");
    if (!file) {
        perror(path);
        exit(2);
    }
    fseek(file, 0, SEEK_END);
    *bytes = (size_t)ftell(file);
    rewind(file);
    void *data = malloc(*bytes);
    if (!data || fread(data, 1, *bytes, file) != *bytes) {
        fprintf(stderr, "%s: cannot be read\n", path);
        exit(2);
    }
    fclose(file);
    return data;
}

static void print_list(const char *name, const double *seconds, int count) {
    printf("\"%s\": [", name);
    for (int i = 0; i < count; i++) printf("%s%.9f", i ? ", " : "", seconds[i]);
    printf("], ");
}

/* max |Ax - b| over (largest row sum of |A|) max |x| + max |b| */
static double backward_error(cholmod_sparse *a, cholmod_dense *x, cholmod_dense *b,
                             cholmod_common *c) {
    double one[2] = {1, 0}, minus[2] = {-1, 0};
    cholmod_dense *r = cholmod_copy_dense(b, c);
    cholmod_sdmult(a, 0, one, minus, x, r, c);
    double error = cholmod_norm_dense(r, 0, c), norm = cholmod_norm_sparse(a, 0, c);
    /* Norms of matrices sum over columns: an upper bound of the scale, for one column exact. */
    double scale = norm * cholmod_norm_dense(x, 0, c) + cholmod_norm_dense(b, 0, c);
    cholmod_free_dense(&r, c);
    return error / scale;
}

int main(int argc, char **argv) {
    if (argc != 3) {
        fprintf(stderr, "cholmod PREFIX REPEAT\n");
        return 2;
    }
    int repeat = atoi(argv[2]);
    double *seconds = malloc(sizeof(double) * (size_t)(repeat > 0 ? repeat : 1));
    size_t ptr_bytes, col_bytes, val_bytes;
    int *ptr = read_all(argv[1], "ptr", &ptr_bytes);
    int *col = read_all(argv[1], "col", &col_bytes);
    double *val = read_all(argv[1], "val", &val_bytes);

    cholmod_common c;
    cholmod_start(&c);
    c.nmethods = 1;
    c.method[0].ordering = CHOLMOD_METIS;
    c.postorder = 1;
    c.supernodal = CHOLMOD_SUPERNODAL;
    c.final_ll = 1;
    cholmod_sparse a = {0};
    a.nrow = a.ncol = ptr_bytes / sizeof(int) - 1;
    a.nzmax = val_bytes / sizeof(double);
    a.p = ptr;
    a.i = col;
    a.x = val;
    a.stype = -1;
    a.itype = CHOLMOD_INT;
    a.xtype = CHOLMOD_REAL;
    a.dtype = CHOLMOD_DOUBLE;
    a.sorted = a.packed = 1;

    printf("{");
    cholmod_factor *l = NULL;
    for (int i = 0; i < repeat; i++) {
        cholmod_free_factor(&l, &c);
        double start = now();
        l = cholmod_analyze(&a, &c);
        seconds[i] = now() - start;
    }
    print_list("analysis_s", seconds, repeat);
    for (int i = 0; i < repeat; i++) {
        double start = now();
        cholmod_factorize(&a, l, &c);
        seconds[i] = now() - start;
    }
    print_list("numeric_s", seconds, repeat);
    double error = 0;
    for (int columns = 1; columns <= 32; columns += 31) {
        cholmod_dense *b = cholmod_zeros(a.nrow, (size_t)columns, CHOLMOD_REAL, &c);
        for (size_t i = 0; i < a.nrow * (size_t)columns; i++)
            ((double *)b->x)[i] = sin(12.9898 * (double)(i + 1));
        for (int i = 0; i < repeat; i++) {
            double start = now();
            cholmod_dense *x = cholmod_solve(CHOLMOD_A, l, b, &c);
            seconds[i] = now() - start;
            if (columns == 1) error = backward_error(&a, x, b, &c);
            cholmod_free_dense(&x, &c);
        }
        print_list(columns == 1 ? "solve_1_s" : "solve_32_s", seconds, repeat);
        cholmod_free_dense(&b, &c);
    }
    printf("\"factor_nonzeros\": %.0f, \"backward_error\": %.3e, \"version\": \"%d.%d.%d\"}\n",
           c.lnz, error, CHOLMOD_MAIN_VERSION, CHOLMOD_SUB_VERSION, CHOLMOD_SUBSUB_VERSION);
    return c.status < CHOLMOD_OK;
}
