#include <string.h>

#include "client/cli.h"
#include "client/import.h"

int main(int argc, char **argv)
{
    if (argc > 1 && strcmp(argv[1], IMPORT_CHILD_ARGUMENT) == 0)
        return import_child_main(argc, argv);
    return cli_main(argc, argv);
}
